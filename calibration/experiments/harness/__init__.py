"""What every experiment has: cells, rows, a runner, presses and their features, tables, figures and a page."""
