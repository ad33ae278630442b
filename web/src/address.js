// Addresses of the server, with the page's token.
export function address(path, query = {}) {
  const url = new URL(path, location.href);
  const token = new URLSearchParams(location.search).get("token");
  for (const [name, value] of Object.entries({ ...query, ...(token && { token }) })) {
    url.searchParams.set(name, value);
  }
  return url;
}
