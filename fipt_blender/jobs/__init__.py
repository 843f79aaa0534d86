"""Jobs on run folders and the data folder, and the one job that runs in a window."""
