"""The commands: their arguments and options, and a module with the work of each."""
