"""Pure vision: views, background models, blobs; metres never enter the blob finder."""
