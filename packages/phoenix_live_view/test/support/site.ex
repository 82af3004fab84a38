defmodule Phoenix.LiveViewTest.Site do
  @moduledoc "A small site on Cowboy for tests with real connections, on a port of its own."

  defmodule Layout do
    @moduledoc false
    use Phoenix.Component

    def root(assigns) do
      ~H"""
      <html lang="en">
        <head><meta name="csrf-token" content={@csrf_token} /><.live_title default="site">{@page_title}</.live_title><script src="/js/page.js" type="module"></script></head>
        <body>{@inner_content}</body>
      </html>
      """
    end
  end

  defmodule Missing do
    @moduledoc false
    defexception message: "no such thing", plug_status: 404
  end

  defmodule Guard do
    @moduledoc false
    import Phoenix.LiveView

    # The GET is let through, so that the join is what is refused.
    def on_mount(:default, _params, _session, socket) do
      if connected?(socket), do: {:halt, redirect(socket, to: "/login")}, else: {:cont, socket}
    end
  end

  defmodule Home do
    @moduledoc false
    use Phoenix.LiveView
    alias Phoenix.LiveView.JS

    def mount(_params, _session, socket) do
      socket =
        assign(socket,
          n: 0,
          q: nil,
          last: "",
          name: "",
          page_title: "0",
          typed: "",
          rows: [1, 2, 3]
        )

      {:ok, push_event(socket, "mounted", %{connected: connected?(socket)})}
    end

    def handle_params(params, _uri, socket), do: {:noreply, assign(socket, :q, params["q"])}

    def handle_event("up", value, socket) do
      n = socket.assigns.n + String.to_integer(value["by"] || "1")

      {:noreply, assign(socket, n: n, page_title: "#{n}", rows: Enum.reverse(socket.assigns.rows))}
    end

    def handle_event("change", params, socket) do
      name = params["user"]["name"]
      {:noreply, assign(socket, typed: name, last: "change #{inspect(params["_target"])} #{name}")}
    end

    def handle_event("save", params, socket),
      do: {:noreply, assign(socket, :last, "save #{params["user"]["name"]}")}

    def handle_event("key", %{"key" => key}, socket), do: {:noreply, assign(socket, :last, "key #{key}")}
    def handle_event("seen", value, socket), do: {:noreply, assign(socket, :name, "seen #{value["id"]}")}
    def handle_event("echo", value, socket), do: {:noreply, push_event(socket, "told", value)}
    def handle_event("patch", _value, socket), do: {:noreply, push_patch(socket, to: "/?q=pushed")}

    def handle_event("go", _value, socket),
      do: {:noreply, socket |> put_flash(:info, "hello") |> redirect(to: "/other/7")}

    def handle_event("away", _value, socket), do: {:noreply, redirect(socket, to: "/login")}
    def handle_event("crash", _value, _socket), do: raise("crash of a test")

    def handle_event("cut", _value, socket) do
      Process.exit(socket.transport_pid, :kill)
      {:noreply, socket}
    end

    def handle_event("flood", %{"n" => n}, socket) do
      for i <- 1..n, do: send(self(), {:hook, i})
      {:noreply, socket}
    end

    def handle_info({:hook, i}, socket),
      do: {:noreply, push_event(socket, "i", %{i: i, fill: String.duplicate("x", 2_000)})}

    def handle_info({:n, n}, socket), do: {:noreply, assign(socket, :n, n)}

    def render(assigns) do
      ~H"""
      <p id="n">{@n}</p><p id="q">{@q}</p><p id="last">{@last}</p><p id="seen">{@name}</p>
      <button id="up" phx-click="up">up</button>
      <button id="two" phx-click={JS.push("up", value: %{by: "2"})}>two</button>
      <button id="patch" phx-click="patch">patch</button><button id="go" phx-click="go">go</button>
      <button id="away" phx-click="away">away</button><button id="crash" phx-click="crash">crash</button>
      <button id="cut" phx-click="cut">cut</button>
      <.link id="link" patch="/?q=linked">linked</.link><.link id="other" navigate="/other/1">other</.link>
      <div id="keys" tabindex="0" phx-keydown="key" phx-key="a"></div>
      <div id="m" phx-mounted={JS.push("seen", value: %{id: "m"})}></div>
      <form id="user" phx-change="change" phx-submit="save"><input id="name" name="user[name]" value={@typed} /><button id="save">save</button></form>
      <div id="hook" phx-hook="Echo" phx-update="ignore">mine</div>
      <ul id="rows"><li :for={row <- @rows} :key={row} id={"row-#{row}"}>{row}</li></ul>
      """
    end
  end

  defmodule Other do
    @moduledoc false
    use Phoenix.LiveView
    def mount(%{"id" => id}, _session, socket), do: {:ok, assign(socket, id: id, page_title: "other #{id}")}

    def render(assigns),
      do:
        ~H|<h1 id="id">{@id}</h1><p id="flash">{@flash["info"]}</p><.link id="home" navigate="/">home</.link>|
  end

  defmodule Late do
    @moduledoc false
    use Phoenix.LiveView

    # Fails only when the browser's WebSocket joins.
    def mount(%{"how" => how}, _session, socket) do
      if connected?(socket), do: raise(if(how == "missing", do: %Missing{}, else: "a join that crashes"))
      {:ok, socket}
    end

    def render(assigns), do: ~H"<p>late</p>"
  end

  defmodule Gone do
    @moduledoc false
    use Phoenix.LiveView
    def mount(_params, _session, _socket), do: raise(Missing)
    def render(assigns), do: ~H""
  end

  defmodule Routes do
    @moduledoc false
    use Phoenix.Router
    import Phoenix.LiveView.Router

    live("/", Home)
    live("/other/:id", Other)
    live("/late/:how", Late)
    live("/gone", Gone)

    live_session :guarded, on_mount: [Guard] do
      live("/guarded", Home)
    end
  end

  @doc "Starts the site under the calling test. Options as `Phoenix.LiveView.Server.new/1`; `:routes`, Cowboy's, stand before."
  def start(options \\ []) do
    {routes, options} = Keyword.pop(options, :routes, [])
    supervisor = ExUnit.Callbacks.start_supervised!(DynamicSupervisor)

    server =
      [
        router: Routes,
        secret: :crypto.strong_rand_bytes(32),
        supervisor: supervisor,
        root_layout: {Layout, :root}
      ]
      |> Keyword.merge(options)
      |> Phoenix.LiveView.Server.new()

    dispatch = :cowboy_router.compile([{:_, routes ++ Phoenix.LiveView.Cowboy.routes(server)}])
    listener = make_ref()
    # A small buffer, so that a browser that does not read is noticed soon.
    transport = %{socket_opts: [ip: {127, 0, 0, 1}, port: 0, sndbuf: 16_384], num_acceptors: 2}
    {:ok, _pid} = :cowboy.start_clear(listener, transport, %{env: %{dispatch: dispatch}})
    ExUnit.Callbacks.on_exit(fn -> :cowboy.stop_listener(listener) end)
    port = :ranch.get_port(listener)
    %{server: server, port: port, url: "http://127.0.0.1:#{port}", listener: listener}
  end
end
