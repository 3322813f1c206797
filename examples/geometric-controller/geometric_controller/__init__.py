"""A geometric tracking controller on SE(3); `control.GeometricController` is the class."""
