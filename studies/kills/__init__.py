"""What `studies.study_kill` kills and disturbs, and how it judges what is left."""
