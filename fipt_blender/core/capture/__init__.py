"""The capture room: rigs, photographs and masks into capture.json."""
