"""The paper's three validations as studies of independent cells, and the reports made from their rows."""
