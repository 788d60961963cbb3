"""Policies, one family per file; each imports its stack when it is made."""
