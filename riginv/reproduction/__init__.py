"""The paper, reproduced: a graph of kept steps, and the tables, figures and claims that come of them."""
