"""One module a step: which panels there are and what each says about a snapshot."""
