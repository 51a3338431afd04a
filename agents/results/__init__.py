"""What runs came to: reading, measures, statistics."""
