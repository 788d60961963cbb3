"""Recipes for the trainers of other projects."""
