"""Electronic data sheets of the two devices, the source of their object dictionaries. Knows no bus."""
