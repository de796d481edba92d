"""The HTML report: the page, its charts and pictures, and the commands that fill it (`svrgs prune --report`,
`svrgs compare`)."""
