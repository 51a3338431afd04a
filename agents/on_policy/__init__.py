"""The common part of the on-policy families: epochs of whole episodes, advantages, critics."""
