"""What an estimate is worth: identifiability, intervals, tests, fault models. Knows no screen or file."""
