"""The experiment in the full MuJoCo dynamics."""
