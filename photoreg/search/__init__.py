"""The genetic algorithm and the cost that it minimises."""
