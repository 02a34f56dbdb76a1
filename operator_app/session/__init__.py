"""The workflow without a screen: states, guards, journal, resume. It prints nothing."""
