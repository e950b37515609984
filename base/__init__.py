"""What any program needs: errors, files, tables, numbers in words, threads and workers; knows no robot."""
