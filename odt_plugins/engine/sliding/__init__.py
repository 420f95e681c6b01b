"""The boundary of a tetrahedral mesh on its way along the input surface."""
