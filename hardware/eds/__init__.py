"""Electronic data sheets of the two devices, generated from `hardware.objects` and never edited."""
