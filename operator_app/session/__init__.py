"""The workflow, independent of any screen: states, guards, journal, resume. It prints nothing."""
