"""What a scan lacks: panes in flat holes, lost surfaces and torn parts."""
