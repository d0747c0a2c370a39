"""Networks from sources, all steps charged: study files, and what they name."""
