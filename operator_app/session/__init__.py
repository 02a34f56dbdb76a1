"""The workflow without a screen: states, guards, journal, resume. Knows no Textual and prints nothing."""
