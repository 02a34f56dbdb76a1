"""What an estimate is worth: identifiability, intervals, tests. Knows no screen or file."""
