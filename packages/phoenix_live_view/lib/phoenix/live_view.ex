defmodule Phoenix.LiveView do
  @moduledoc """
  A page that lives in a process: its state is the `assigns` of a `Phoenix.LiveView.Socket`, from which
  `render/1` makes the page. The browser sends events, the process sends changes.

      defmodule Thermostat do
        use Phoenix.LiveView

        def mount(_params, _session, socket), do: {:ok, assign(socket, :degrees, 20)}

        def handle_event("up", _value, socket), do: {:noreply, update(socket, :degrees, &(&1 + 1))}

        def render(assigns) do
          ~H\"\"\"
          <button phx-click="up">{@degrees} °C</button>
          \"\"\"
        end
      end

  A page is rendered twice: once into the answer to the GET, by the process of that request (`connected?/1` is false), and once
  when the browser's WebSocket has joined, by the process that stays. `mount/3` must therefore do nothing that may not happen
  twice, and subscribe only if it is connected.
  """

  alias Phoenix.LiveView.{Lifecycle, Navigation, Socket}

  @type unsigned_params :: map()

  @doc "Prepares the socket. `params` are those of the route and the query, or `:not_mounted_at_router`."
  @callback mount(params :: unsigned_params() | :not_mounted_at_router, session :: map(), Socket.t()) ::
              {:ok, Socket.t()} | {:ok, Socket.t(), keyword()}
  @doc "Renders the page."
  @callback render(assigns :: map()) :: Phoenix.LiveView.Rendered.t()
  @doc "Handles the URL: after `mount/3`, and after each patch."
  @callback handle_params(unsigned_params(), uri :: String.t(), Socket.t()) :: {:noreply, Socket.t()}
  @doc "Handles an event of the browser."
  @callback handle_event(event :: String.t(), unsigned_params(), Socket.t()) ::
              {:noreply, Socket.t()} | {:reply, map(), Socket.t()}
  @doc "Handles a message to the view's process."
  @callback handle_info(message :: term(), Socket.t()) :: {:noreply, Socket.t()}
  @callback handle_call(message :: term(), GenServer.from(), Socket.t()) ::
              {:noreply, Socket.t()} | {:reply, term(), Socket.t()}
  @callback handle_cast(message :: term(), Socket.t()) :: {:noreply, Socket.t()}
  @callback terminate(reason :: term(), Socket.t()) :: term()

  @optional_callbacks mount: 3,
                      render: 1,
                      handle_params: 3,
                      handle_event: 3,
                      handle_info: 2,
                      handle_call: 3,
                      handle_cast: 2,
                      terminate: 2

  @doc """
  Options: `:layout`, `{module, function name}` around what the view renders, or false; `:container`, `{tag, attributes}` of the
  element that holds the view.
  """
  defmacro __using__(options) do
    quote do
      @behaviour Phoenix.LiveView
      @before_compile Phoenix.LiveView
      use Phoenix.Component
      import Phoenix.LiveView
      Module.register_attribute(__MODULE__, :phoenix_live_mount, accumulate: true)
      @phoenix_live_options unquote(options)
    end
  end

  @doc false
  defmacro __before_compile__(env) do
    options = Module.get_attribute(env.module, :phoenix_live_options)
    hooks = env.module |> Module.get_attribute(:phoenix_live_mount) |> Enum.reverse()

    live = %{
      layout: Keyword.get(options, :layout),
      container: Keyword.get(options, :container, {:div, []}),
      on_mount: hooks
    }

    quote do
      @doc false
      def __live__, do: unquote(Macro.escape(live))
    end
  end

  @doc "Runs `module.on_mount(argument, params, session, socket)` before `mount/3`: `{:cont, socket}` or `{:halt, socket}`."
  defmacro on_mount(hook) do
    quote do: @phoenix_live_mount(Phoenix.LiveView.Lifecycle.on_mount(unquote(hook)))
  end

  @doc "Whether the browser's WebSocket has joined; false during the request of the page."
  @spec connected?(Socket.t()) :: boolean()
  def connected?(%Socket{transport_pid: pid}), do: pid != nil

  @doc "Sends an event to the client's hooks (`handleEvent`). Option `dispatch: :before`: before the page is patched."
  @spec push_event(Socket.t(), String.t(), map(), keyword()) :: Socket.t()
  def push_event(socket, event, payload, options \\ []) when is_binary(event) do
    entry = if options[:dispatch] == :before, do: [event, payload, true], else: [event, payload]
    put_private(socket, :push_events, [entry | socket.private[:push_events] || []])
  end

  @doc "Changes the URL without leaving the view: `handle_params/3` follows. Options: `:to`, a path; `:replace`."
  @spec push_patch(Socket.t(), keyword()) :: Socket.t()
  def push_patch(socket, options), do: Navigation.ask(socket, :patch, options)

  @doc "Goes to another view in the same connection. Options as `push_patch/2`."
  @spec push_navigate(Socket.t(), keyword()) :: Socket.t()
  def push_navigate(socket, options), do: Navigation.ask(socket, :navigate, options)

  @doc "Loads another page. Options: `:to`, a path, or `:external`, a URL."
  @spec redirect(Socket.t(), keyword()) :: Socket.t()
  def redirect(socket, options), do: Navigation.ask(socket, :redirect, options)

  @doc "A message for the user, shown until it is cleared or the user navigates."
  @spec put_flash(Socket.t(), atom() | String.t(), term()) :: Socket.t()
  def put_flash(%Socket{} = socket, kind, message),
    do: flash(socket, Map.put(socket.assigns.flash, to_string(kind), message))

  @doc "Clears all messages, or those of one kind."
  @spec clear_flash(Socket.t()) :: Socket.t()
  def clear_flash(%Socket{} = socket), do: flash(socket, %{})
  @spec clear_flash(Socket.t(), atom() | String.t()) :: Socket.t()
  def clear_flash(%Socket{} = socket, kind),
    do: flash(socket, Map.delete(socket.assigns.flash, to_string(kind)))

  defp flash(%{assigns: %{flash: flash}} = socket, flash), do: socket

  defp flash(%{assigns: assigns} = socket, flash),
    do: %{
      socket
      | assigns: %{assigns | flash: flash, __changed__: Map.put(assigns.__changed__, :flash, true)}
    }

  @doc """
  Runs a function before the view's own callback at a stage: `:handle_params`, `:handle_event`, `:handle_info`, `:after_render`. It
  returns `{:cont, socket}` or `{:halt, socket}` (`{:halt, reply, socket}` for events); at `:after_render`, the socket.
  """
  @spec attach_hook(Socket.t(), term(), Lifecycle.stage(), function()) :: Socket.t()
  defdelegate attach_hook(socket, name, stage, fun), to: Lifecycle, as: :attach

  @doc "Removes a hook."
  @spec detach_hook(Socket.t(), term(), Lifecycle.stage()) :: Socket.t()
  defdelegate detach_hook(socket, name, stage), to: Lifecycle, as: :detach

  @doc "The `params` of the page's JavaScript, during mount; nil if not connected."
  @spec get_connect_params(Socket.t()) :: map() | nil
  def get_connect_params(%Socket{private: private} = socket),
    do: if(connected?(socket), do: private[:connect_params])

  @doc "A fact about the connection, during mount: `:peer_data`, `:user_agent`, `:session`, `:uri`, `:x_headers`."
  @spec get_connect_info(Socket.t(), atom()) :: term()
  def get_connect_info(%Socket{private: private}, key), do: get_in(private, [:connect_info, key])

  @doc "The process of the WebSocket, nil if not connected."
  @spec transport_pid(Socket.t()) :: pid() | nil
  def transport_pid(%Socket{transport_pid: pid}), do: pid

  @doc "Keeps a value in the socket that templates do not see."
  @spec put_private(Socket.t(), atom(), term()) :: Socket.t()
  def put_private(%Socket{private: private} = socket, key, value),
    do: %{socket | private: Map.put(private, key, value)}

  @doc false
  @spec put_action(Socket.t(), atom() | nil) :: Socket.t()
  def put_action(%{assigns: %{live_action: action}} = socket, action), do: socket

  def put_action(%{assigns: assigns} = socket, action),
    do: %{
      socket
      | assigns: %{
          assigns
          | live_action: action,
            __changed__: Map.put(assigns.__changed__, :live_action, true)
        }
    }
end
