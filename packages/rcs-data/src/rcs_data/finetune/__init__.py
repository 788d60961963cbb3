"""What other projects' trainers need to know about a dataset, written as their own configuration."""
