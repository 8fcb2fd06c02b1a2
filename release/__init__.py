"""What is checked before a version is published; started by tasks.py, on its own no command."""
