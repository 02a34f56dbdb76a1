"""What a fit implies at the poses where the arm is used: corrections of readings, the best D-H table, tool uncertainty."""
