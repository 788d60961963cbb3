"""Policies around a policy: each does one thing to what goes in or comes out."""
