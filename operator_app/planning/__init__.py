"""Planning: drive joints and poses."""
