"""What pictures need beside `render`: the tracer, its variants, a photograph behind them."""
