"""Wires of others, a file each: our clients ask their servers, and their clients ask ours."""
