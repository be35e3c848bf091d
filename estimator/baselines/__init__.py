"""Estimators to compare with: solvers of SciPy and Ipopt, Kalman filters, a moving horizon."""
