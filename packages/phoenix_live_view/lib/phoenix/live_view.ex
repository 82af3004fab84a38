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

  alias Phoenix.LiveView.Socket
  alias Phoenix.LiveView.View.{Lifecycle, Navigation}

  @type unsigned_params :: map()

  @doc "Prepares the socket. `params` are those of the route and the query."
  @callback mount(params :: unsigned_params(), session :: map(), Socket.t()) :: {:ok, Socket.t()}
  @doc "Renders the page."
  @callback render(assigns :: map()) :: Phoenix.LiveView.Rendered.t()
  @doc "Handles the URL: after `mount/3`, and after each patch."
  @callback handle_params(unsigned_params(), uri :: String.t(), Socket.t()) :: {:noreply, Socket.t()}
  @doc "Handles an event of the browser."
  @callback handle_event(event :: String.t(), unsigned_params(), Socket.t()) :: {:noreply, Socket.t()}
  @doc "Handles a message to the view's process."
  @callback handle_info(message :: term(), Socket.t()) :: {:noreply, Socket.t()}

  @optional_callbacks mount: 3, handle_params: 3, handle_event: 3, handle_info: 2

  @doc false
  defmacro __using__(_options) do
    quote do
      @behaviour Phoenix.LiveView
      use Phoenix.Component
      import Phoenix.LiveView
    end
  end

  @doc "Whether the browser's WebSocket has joined; false during the request of the page."
  @spec connected?(Socket.t()) :: boolean()
  def connected?(%Socket{transport_pid: pid}), do: pid != nil

  @doc "Sends an event to the client's hooks (`handleEvent`)."
  @spec push_event(Socket.t(), String.t(), map()) :: Socket.t()
  def push_event(socket, event, payload) when is_binary(event),
    do: put_private(socket, :push_events, [[event, payload] | socket.private[:push_events] || []])

  @doc "Changes the URL without leaving the view: `handle_params/3` follows. Options: `:to`, a path; `:replace`."
  @spec push_patch(Socket.t(), keyword()) :: Socket.t()
  def push_patch(socket, options), do: Navigation.ask(socket, :patch, options)

  @doc "Loads another page. Option `:to`: a path."
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
  Runs a function before the view's own callback at a stage: `:handle_params`, `:handle_event`, `:handle_info`. It returns
  `{:cont, socket}` or `{:halt, socket}`.
  """
  @spec attach_hook(Socket.t(), term(), Lifecycle.stage(), function()) :: Socket.t()
  defdelegate attach_hook(socket, name, stage, fun), to: Lifecycle, as: :attach

  @doc "A fact about the connection, during mount: `:peer_data` (address and port), `:session`."
  @spec get_connect_info(Socket.t(), atom()) :: term()
  def get_connect_info(%Socket{private: private}, key), do: get_in(private, [:connect_info, key])

  @doc "Keeps a value in the socket that templates do not see."
  @spec put_private(Socket.t(), atom(), term()) :: Socket.t()
  def put_private(%Socket{private: private} = socket, key, value),
    do: %{socket | private: Map.put(private, key, value)}
end
