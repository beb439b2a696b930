"""What verdicts were made from is kept, so that they can be made again."""
