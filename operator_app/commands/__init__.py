"""The commands of `sarcal`: their arguments and options, and for each command a module that does its work."""
