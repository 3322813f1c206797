"""How well one vehicle flies, measured (docs/results/validation.md), and what a step of it costs."""
