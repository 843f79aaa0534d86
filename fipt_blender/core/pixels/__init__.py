"""What the photographs' pixels see: rays, grouped sums, mixed pixels and their unmixing."""
