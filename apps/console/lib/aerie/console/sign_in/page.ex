defmodule Aerie.Console.SignIn.Page do
  @moduledoc "The sign-in page. It is not a live page, so unknown visitors get no process."
  use Aerie.Console, :component

  alias Aerie.Console.Layout

  @doc "The HTML. `message` says what went wrong; `exposed` who could read along; `users?` whether there are any users."
  @spec html(map()) :: iodata()
  def html(assigns) do
    content = Map.merge(%{__changed__: nil}, assigns) |> render()

    root =
      Layout.root(
        Map.merge(assigns, %{__changed__: nil, inner_content: content, page_title: "Sign in", live: false})
      )

    ["<!DOCTYPE html>\n", Phoenix.HTML.Safe.to_iodata(root)]
  end

  defp render(assigns) do
    ~H"""
    <main id="main" class="sign-in">
      <div class="card sign-in-card">
        <h1><.logo /> Aerie</h1>
        <p :if={@message} class="notice bad" role="alert">{@message}</p>
        <p :if={@exposed} class="notice warn" role="note"><.icon name="alert" /> <span>{@exposed}</span></p>
        <form :if={@users?} action="/sign-in" method="post" class="stack">
          <input type="hidden" name="_csrf_token" value={@csrf_token} />
          <.field id="name" name="name" label="Name" autocomplete="username" autofocus required />
          <.field id="password" name="password" label="Password" type="password" autocomplete="current-password" required />
          <.button kind="primary" type="submit">Sign in</.button>
        </form>
        <div :if={!@users?} class="stack">
          <p>Nobody has a password yet.</p>
          <p class="muted">
            At the gateway's own machine, open the address that <code>bin/run</code>
            prints. It signs you in as admin. Then add users in the settings.
          </p>
        </div>
      </div>
    </main>
    """
  end
end
