"""Print the table of the autopilot's parameters, which is docs/parameters.md."""

from autopilot.parameter_docs import markdown

if __name__ == "__main__":
    print(markdown(), end="")
