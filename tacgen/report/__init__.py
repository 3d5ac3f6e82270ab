"""Figures, summaries, dataset cards, HTML reports and tables, made from bundles."""
