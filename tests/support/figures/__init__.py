"""Claims of the documents, each made from the figures of a page of docs/results."""
