"""What a person writes, read and checked: recipes, sensor files, moves, pose tables."""
