"""An arm on the bench: what every arm owes the workflow, tried in a safe order, asked before anything moves."""
