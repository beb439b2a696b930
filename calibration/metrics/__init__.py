"""Exact measures of scored presses: AUROC, average precision, AU-PRO, AUPIMO, with bootstrap intervals.

A score is raw and higher is more anomalous. A measure that is undefined (no defective press, no good press) is None
with a reason.
"""
