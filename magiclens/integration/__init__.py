"""From chosen transformations to heights: orientation (4.3) and integration (4.5), iterated."""
