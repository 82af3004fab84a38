defmodule Aerie.Console.Frame do
  @moduledoc """
  What is around a page and stays as it is while the page is open: its entries in the navigation and in the menu, and the list of keys.
  They are rendered once for each path (`@frame`), and not each time that a value on the page changes.
  """
  use Aerie.Console, :component

  import Phoenix.LiveView, only: [attach_hook: 4]

  alias Aerie.Console.Pages

  @doc false
  def on_mount(:default, _params, _session, socket) do
    {:cont,
     socket
     |> frame()
     |> attach_hook(:console_frame, :handle_params, fn _params, _uri, socket -> {:cont, frame(socket)} end)}
  end

  defp frame(%{assigns: %{user: user, path: path}} = socket) do
    entries = Pages.entries(user.role)
    assigns = %{entries: entries, path: path, csrf_token: socket.assigns.csrf_token, __changed__: nil}
    assign(socket, :frame, %{nav: nav(assigns), menu: menu(assigns), help: help(assigns)})
  end

  defp nav(assigns) do
    ~H"""
    <nav class="nav" aria-label="Pages">
      <.nav_link :for={entry <- @entries} entry={entry} path={@path} class={if(not entry.main, do: "wide-only")} />
    </nav>
    """
  end

  defp menu(assigns) do
    ~H"""
    <.nav_link :for={entry <- @entries} :if={not entry.main} entry={entry} path={@path} class="phone-only" />
    <button type="button" data-action="theme"><.icon name="contrast" /> Dark or light</button>
    <button type="button" data-action="help"><.icon name="keyboard" /> Keyboard shortcuts <kbd>?</kbd></button>
    <form action="/sign-out" method="post">
      <input type="hidden" name="_csrf_token" value={@csrf_token} />
      <button type="submit"><.icon name="sign-out" /> Sign out</button>
    </form>
    """
  end

  defp help(assigns) do
    ~H"""
    <dialog id="help" class="dialog" aria-labelledby="help-title" phx-mounted={JS.ignore_attributes("open")}>
      <header>
        <h2 id="help-title">Keyboard shortcuts</h2>
        <.button kind="quiet" icon="x" label="Close" data-action="close" />
      </header>
      <div class="dialog-body">
        <dl class="facts">
          <dt><kbd>h</kbd> held</dt>
          <dd>hold: the selected vehicle stays where it is</dd>
          <dt><kbd>r</kbd> held</dt>
          <dd>return the selected vehicle to its home</dd>
          <dt><kbd>l</kbd> held</dt>
          <dd>land the selected vehicle where it is</dd>
          <.go :for={entry <- @entries} entry={entry} />
          <dt><kbd>?</kbd></dt>
          <dd>this list</dd>
          <dt><kbd>Esc</kbd></dt>
          <dd>close, cancel</dd>
        </dl>
      </div>
    </dialog>
    """
  end

  attr :entry, :map, required: true

  defp go(assigns) do
    ~H"""
    <dt><kbd>g</kbd> <kbd>{@entry.key}</kbd></dt>
    <dd>{@entry.label}</dd>
    """
  end

  attr :entry, :map, required: true
  attr :path, :string, required: true
  attr :class, :string, default: nil

  defp nav_link(assigns) do
    ~H"""
    <.link
      navigate={@entry.path}
      class={["nav-link", @class]}
      data-key={@entry.key}
      aria-current={if(Pages.current?(@entry, @path), do: "page")}
    ><.icon name={@entry.icon} /><span>{@entry.label}</span></.link>
    """
  end
end
