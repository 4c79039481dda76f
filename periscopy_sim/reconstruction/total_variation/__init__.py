"""Total variation: its proximal operators (Eq. 10 to 12) and the solver behind them."""
