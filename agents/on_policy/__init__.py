"""The common part of on-policy families: epochs of whole episodes, advantages, critics."""
