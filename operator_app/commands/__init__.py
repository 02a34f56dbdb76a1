"""The commands of `sarcal`: arguments and options, and one module for the work of each command."""
