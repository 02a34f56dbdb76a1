"""Commands of `sarcal`: their arguments and options, and a module for the work of each command."""
