defmodule Aerie.Console.Frame do
  @moduledoc """
  What is around a page and stays as it is while the page is open: its entries in the navigation and in the menu, and the list of keys.
  They are rendered once for each path (`@frame`), and not each time that a value on the page changes.
  """
  use Aerie.Console, :component

  import Phoenix.LiveView, only: [attach_hook: 4, push_event: 3]

  alias Aerie.Console.Frame.Palette
  alias Aerie.Console.Pages

  @doc false
  def on_mount(:default, _params, _session, socket) do
    {:cont,
     socket
     |> frame()
     |> attach_hook(:console_frame, :handle_params, fn _params, _uri, socket -> {:cont, frame(socket)} end)
     |> attach_hook(:console_palette, :handle_event, &palette/3)}
  end

  defp palette(
         "palette",
         %{"query" => query},
         %{assigns: %{gateway: gateway, user: user, path: path}} = socket
       ),
       do:
         {:halt,
          push_event(socket, "palette", %{query: query, items: Palette.find(gateway, user, path, query)})}

  defp palette(_event, _value, socket), do: {:cont, socket}

  defp frame(%{assigns: %{user: user, path: path}} = socket) do
    entries = Pages.entries(user.role)
    assigns = %{entries: entries, path: path, csrf_token: socket.assigns.csrf_token, __changed__: nil}
    assign(socket, :frame, %{nav: nav(assigns), menu: menu(assigns), help: help(assigns)})
  end

  defp nav(assigns) do
    ~H"""
    <nav class="nav" aria-label="Pages">
      <.nav_link
        :for={entry <- @entries} :if={not entry.gateway} entry={entry} path={@path}
        class={if(not entry.main, do: "wide-only")}
      />
      <div class="nav-group wide-only" role="group" aria-label="Gateway">
        <.nav_link :for={entry <- @entries} :if={entry.gateway} entry={entry} path={@path} />
      </div>
    </nav>
    """
  end

  defp menu(assigns) do
    ~H"""
    <.nav_link :for={entry <- @entries} :if={not entry.main} entry={entry} path={@path} class="phone-only" />
    <button type="button" data-action="palette"><.icon name="search" /> Find… <kbd>Ctrl K</kbd></button>
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
    <p id="hold-note" hidden>Press and hold</p>
    <dialog id="palette" class="dialog palette" aria-label="Go to" phx-hook="Palette" phx-update="ignore">
      <input
        type="text" role="combobox" aria-label="Vehicle, page, command or parameter" aria-expanded="true"
        aria-controls="palette-list" aria-autocomplete="list" autocomplete="off" spellcheck="false"
        maxlength="60" placeholder="Vehicle, page, command, parameter"
      />
      <ul id="palette-list" role="listbox" aria-label="Found"></ul>
      <p class="hint" role="status"></p>
    </dialog>
    <dialog id="help" class="dialog" aria-labelledby="help-title" phx-mounted={JS.ignore_attributes("open")}>
      <header>
        <h2 id="help-title">Keyboard shortcuts</h2>
        <.button kind="quiet" icon="x" label="Close" data-action="close" />
      </header>
      <div class="dialog-body">
        <dl class="facts">
          <dt><kbd>Shift</kbd> <kbd>Esc</kbd> held</dt>
          <dd>hold all in the air that are yours or nobody's</dd>
          <dt><kbd>h</kbd> held</dt>
          <dd>hold: the selected vehicle stays where it is</dd>
          <dt><kbd>r</kbd> held</dt>
          <dd>return the selected vehicle to its home</dd>
          <dt><kbd>l</kbd> held</dt>
          <dd>land the selected vehicle where it is</dd>
          <dt><kbd>a</kbd> held</dt>
          <dd>arm the vehicle, on its page</dd>
          <dt><kbd>t</kbd> held</dt>
          <dd>take off to the height in the card, on the vehicle's page</dd>
          <dt><kbd>1</kbd> to <kbd>9</kbd></dt>
          <dd>select the vehicles of a tag, on the fleet's page</dd>
          <dt><kbd>\</kbd></dt>
          <dd>fold the fleet's table away, or show it</dd>
          <dt><kbd>Ctrl</kbd> <kbd>k</kbd></dt>
          <dd>go to a vehicle, page, command or parameter by its name</dd>
          <dt><kbd>/</kbd></dt>
          <dd>the page's search</dd>
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
