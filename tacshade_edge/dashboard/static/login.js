// The page sends the token to the server in a header; the server returns it as a cookie that no script can read.

const form = document.getElementById("login"), why = document.getElementById("login-why");

async function login(token) {
  try {
    const answer = await fetch("login", { headers: { Authorization: `Bearer ${token}` }, cache: "no-store" });
    if (answer.ok) location.replace("./");
    else why.textContent = await answer.text();
  } catch {
    why.textContent = "the dashboard's server does not answer";
  }
}

form.addEventListener("submit", (event) => {
  event.preventDefault();
  login(form.elements.token.value.trim());
});

// The address that the server printed has the token after its #, a part that browsers never send to any site.
if (location.hash.length > 1) {
  const token = location.hash.slice(1);
  history.replaceState(null, "", "login");
  login(token);
}
