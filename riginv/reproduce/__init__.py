"""The paper, reproduced: steps, tables, claims and the report."""
