"""How well one vehicle flies, measured (docs/validation.md is made of it), and what a step of it costs."""
