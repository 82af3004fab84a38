defmodule Phoenix.LiveView.Channel do
  @max_unwritten 4
  @max_kept 1_000

  @moduledoc """
  The process of one view in one browser. It carries out the actions of `Phoenix.LiveView.View`, encodes the messages, and passes them
  to the process of the WebSocket, with which it ends.

  An event is answered at once. Changes by other messages are rendered together, at most once in the server's `:render_ms`. While
  #{@max_unwritten} messages have not been written to the browser yet, only answers are rendered: a slow browser gets the newest state
  later, not all states. Only events for hooks are queued for it; beyond #{@max_kept} of them, the
  view ends and the client joins again as after a crash.
  """
  use GenServer, restart: :temporary

  alias Phoenix.LiveView.View

  require Logger

  @typedoc """
  `:transport` and `:topic`, `:join_ref`; `:join`, a function that gives the outcome of the join; `:encode`, what the transport gets of a
  message; `:priority` of the process.
  """
  @type option ::
          {:transport, pid()}
          | {:topic, String.t()}
          | {:join_ref, String.t()}
          | {:join, (pid() -> joined())}
          | {:priority, :low | :normal}
          | {:encode, (String.t() | nil, String.t() | nil, String.t(), String.t(), map() -> term())}
  @type joined :: {:ok, map(), View.t()} | {:error, map()}

  @spec start_link([option()]) :: GenServer.on_start()
  def start_link(options), do: GenServer.start_link(__MODULE__, options)

  @doc "An event of the client."
  @spec event(pid(), ref :: String.t(), String.t(), map()) :: :ok
  def event(channel, ref, event, payload) do
    send(channel, {__MODULE__, :event, ref, event, payload})
    :ok
  end

  @doc "A message of the channel was written to the browser."
  @spec written(pid()) :: :ok
  def written(channel) do
    send(channel, {__MODULE__, :written})
    :ok
  end

  @doc "The client has left the view."
  @spec leave(pid()) :: :ok
  def leave(channel) do
    send(channel, {__MODULE__, :leave})
    :ok
  end

  @impl GenServer
  def init(options) do
    Process.set_label({:live_view, options[:topic]})
    _monitor = Process.monitor(options[:transport])
    _normal = Process.flag(:priority, Keyword.get(options, :priority, :normal))

    state =
      Map.merge(
        %{view: nil, dirty?: false, timer: nil, rendered: nil, unwritten: 0},
        Map.new(options)
      )

    {:ok, state, {:continue, :join}}
  end

  @impl GenServer
  def handle_continue(:join, %{join: join} = state) do
    state = %{state | join: nil}

    case join.(state.transport) do
      {:ok, response, view} ->
        {:noreply, state |> reply(state.join_ref, "ok", response) |> Map.put(:view, view)}

      {:error, response} ->
        {:stop, {:shutdown, :refused}, reply(state, state.join_ref, "error", response)}
    end
  end

  @impl GenServer
  def handle_info({:DOWN, _monitor, :process, transport, _reason}, %{transport: transport} = state),
    do: {:stop, {:shutdown, :closed}, state}

  def handle_info({__MODULE__, :event, ref, event, payload}, state) do
    {actions, view} =
      case event do
        "event" -> View.event(state.view, payload)
        "live_patch" -> View.patch(state.view, payload)
        # Events of components and uploads, which this package does not have.
        _other -> View.flush(state.view)
      end

    act(actions, ref, %{state | view: view, dirty?: false})
  end

  def handle_info({__MODULE__, :written}, state), do: later(%{state | unwritten: state.unwritten - 1})
  def handle_info({__MODULE__, :render}, state), do: render(%{state | timer: nil})
  def handle_info({__MODULE__, :leave}, state), do: {:stop, {:shutdown, :left}, state}

  def handle_info(message, state), do: changed(state, View.message(state.view, message))

  # A page may have sent a password, and a view's state fills screens: crash reports contain neither.
  @impl GenServer
  def format_status(status) do
    status
    |> Map.replace_lazy(:state, &Map.take(&1, [:topic, :join_ref, :unwritten]))
    |> Map.replace_lazy(:message, fn
      {__MODULE__, :event, _ref, event, payload} -> {event, Map.take(payload, ["type", "event"])}
      _other -> :hidden
    end)
  end

  defp changed(state, view), do: later(%{state | view: view, dirty?: true})

  # The timer's message comes after those that are already waiting, which are therefore rendered together.
  defp later(%{dirty?: false} = state), do: {:noreply, state}
  defp later(%{timer: timer} = state) when timer != nil, do: {:noreply, state}

  defp later(%{unwritten: unwritten, view: view} = state) when unwritten >= @max_unwritten do
    if View.kept(view) <= @max_kept do
      {:noreply, state}
    else
      {:stop, {:shutdown, :slow}, state}
    end
  end

  defp later(%{rendered: rendered, view: view} = state) do
    wait = if rendered, do: max(rendered + view.server.render_ms - now(), 0), else: 0
    {:noreply, %{state | timer: Process.send_after(self(), {__MODULE__, :render}, wait)}}
  end

  defp render(%{dirty?: false} = state), do: {:noreply, state}
  defp render(%{unwritten: unwritten} = state) when unwritten >= @max_unwritten, do: later(state)

  defp render(state) do
    {actions, view} = View.refresh(state.view)
    # What sent nothing does not keep the next one waiting.
    rendered = if actions == [], do: state.rendered, else: now()
    act(actions, nil, %{state | view: view, dirty?: false, rendered: rendered})
  end

  defp act([:stop | _rest], _ref, state), do: {:stop, {:shutdown, :left}, state}
  defp act([{:reply, payload} | rest], ref, state), do: act(rest, ref, reply(state, ref, "ok", payload))

  defp act([{:push, event, payload} | rest], ref, state),
    do: act(rest, ref, write(state, nil, event, payload))

  defp act([{:refused, words} | rest], ref, state) do
    Logger.warning("#{inspect(state.view.route.view)} ignored what its page sent: #{words}")
    act(rest, ref, state)
  end

  defp act([], _ref, state), do: {:noreply, state}

  defp reply(state, ref, status, response),
    do: write(state, ref, "phx_reply", %{status: status, response: response})

  defp write(state, ref, event, payload) do
    frame = state.encode.(state.join_ref, ref, state.topic, event, payload)
    send(state.transport, {__MODULE__, self(), frame})
    %{state | unwritten: state.unwritten + 1}
  end

  defp now, do: System.monotonic_time(:millisecond)
end
