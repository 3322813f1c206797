"""What the vehicles' sensors report of the truth: noise, biases, rates and delays. No I/O."""
