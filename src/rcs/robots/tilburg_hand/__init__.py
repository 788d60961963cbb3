"""The Tilburg Hand, with sixteen driven joints in a thumb and three fingers."""
