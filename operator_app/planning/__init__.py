"""Selection of the drive joints and planning of poses."""
