"""From near to exact: the terms of the least-squares problem and its solver."""
