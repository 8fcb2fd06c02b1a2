"""The terminal command: a file a group of subcommands."""
