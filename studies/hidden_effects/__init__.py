"""What the study of hidden effects hides, and how it judges what was found."""
