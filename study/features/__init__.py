"""What candidates are compared by: arrays of anybody, or what a store's rows survive."""
