"""What recordings say of a bundle, each figure in a file: definitions, counts, exact intervals."""
