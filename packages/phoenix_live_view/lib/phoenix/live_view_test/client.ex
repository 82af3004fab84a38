defmodule Phoenix.LiveViewTest.Client do
  @moduledoc false
  # A test's browser: joins a page's view, keeps the tree that the view sends, and sends the test's events. It takes the place of the
  # WebSocket's process, so everything passes through the wire encoding. Only the events for hooks reach the test as they were pushed.
  use GenServer

  alias Phoenix.LiveView.Channel
  alias Phoenix.LiveView.Cowboy.Frame
  alias Phoenix.LiveView.View.Join
  alias Phoenix.LiveViewTest.Tree

  @timeout_ms 60_000

  @spec start(keyword()) :: {:ok, pid()} | {:error, map()}
  def start(options) do
    {:ok, client} = GenServer.start(__MODULE__, options)
    with :ok <- GenServer.call(client, :joined, @timeout_ms), do: {:ok, client}
  end

  @doc "Sends an event and waits for its answer, or for where the view went."
  @spec push(pid(), String.t(), map()) :: :ok | {:away, {String.t(), map()}}
  def push(client, event, payload), do: GenServer.call(client, {:push, event, payload}, @timeout_ms)

  @doc "The page as HTML, after the view has handled all earlier messages."
  @spec html(pid()) :: {:ok, String.t()} | {:away, {String.t(), map()}}
  def html(client) do
    with :ok <- push(client, "sync", %{}), do: {:ok, GenServer.call(client, :html, @timeout_ms)}
  end

  @doc "A value that the client keeps: `:title`, `:channel`, `:away`, `:url`."
  @spec get(pid(), atom()) :: term()
  def get(client, key), do: GenServer.call(client, {:get, key}, @timeout_ms)

  @impl GenServer
  def init(options) do
    Process.monitor(options[:owner])
    server = options[:server]
    topic = "lv:" <> options[:id]
    info = options[:info]
    payload = options[:payload] |> JSON.encode!() |> JSON.decode!()
    join = fn transport -> Join.join(server, topic, payload, info, transport) end
    arguments = [transport: self(), topic: topic, join_ref: "1", join: join, encode: &encode/5]
    {:ok, channel} = DynamicSupervisor.start_child(server.supervisor, {Channel, arguments})

    state = %{
      owner: options[:owner],
      channel: channel,
      monitor: Process.monitor(channel),
      ref: 1,
      waiting: %{},
      tree: nil,
      title: nil,
      url: options[:payload]["url"],
      away: nil
    }

    {:ok, state}
  end

  @impl GenServer
  def handle_call(:joined, _from, %{away: {_refused, response}} = state),
    do: {:reply, {:error, response}, state}

  def handle_call(:joined, _from, %{tree: tree} = state) when tree != nil, do: {:reply, :ok, state}
  def handle_call(:joined, from, state), do: {:noreply, put_in(state.waiting["1"], from)}

  def handle_call({:push, _event, _payload}, _from, %{away: {_, _} = away} = state),
    do: {:reply, {:away, away}, state}

  def handle_call({:push, event, payload}, from, state) do
    ref = Integer.to_string(state.ref + 1)
    Channel.event(state.channel, ref, event, payload |> JSON.encode!() |> JSON.decode!())
    {:noreply, %{state | ref: state.ref + 1, waiting: Map.put(state.waiting, ref, from)}}
  end

  def handle_call(:html, _from, state),
    do: {:reply, state.tree |> Tree.html() |> IO.iodata_to_binary(), state}

  def handle_call({:get, key}, _from, state), do: {:reply, Map.fetch!(state, key), state}

  @impl GenServer
  def handle_info({Channel, channel, {sent, frame}}, state) do
    Channel.written(channel)

    for [name, payload | _] <- pushed(sent),
        do: send(state.owner, {__MODULE__, self(), :event, name, payload})

    ["1", ref, _topic, event, payload] = frame |> IO.iodata_to_binary() |> JSON.decode!()
    {:noreply, heard(event, ref, payload, state)}
  end

  def handle_info({:DOWN, monitor, :process, _channel, reason}, %{monitor: monitor} = state) do
    # Requests to a view that crashed get no answer.
    for {_ref, from} <- state.waiting,
        do: GenServer.reply(from, {:away, state.away || {"crash", %{reason: reason}}})

    away =
      state.away ||
        if(match?({:shutdown, _}, reason), do: {"closed", %{}}, else: {"crash", %{reason: reason}})

    {:noreply, %{state | waiting: %{}, away: away}}
  end

  # The test is over.
  def handle_info({:DOWN, _monitor, :process, _owner, _reason}, state), do: {:stop, :normal, state}

  defp heard("phx_reply", "1", %{"status" => "ok", "response" => response}, %{tree: nil} = state) do
    state = patched(response["live_patch"], merged(response["rendered"], state))
    answer(state, "1", :ok)
  end

  defp heard("phx_reply", "1", %{"status" => "error", "response" => response}, state),
    do: answer(%{state | away: {"refused", response}}, "1", {:error, response})

  defp heard("phx_reply", ref, %{"response" => response}, state) do
    state = merged(response["diff"] || %{}, state)

    case response do
      %{"redirect" => target} -> answer(told(target, state), ref, {:away, {"redirect", target}})
      _diff -> answer(state, ref, :ok)
    end
  end

  defp heard("diff", _ref, diff, state), do: merged(diff, state)
  defp heard("live_patch", _ref, patch, state), do: patched(patch, state)

  defp heard("redirect", _ref, target, state), do: told(target, state)
  defp heard(_other, _ref, _payload, state), do: state

  defp merged(diff, state) do
    {extras, tree} = Map.split(diff, ["e", "t"])
    tree = if tree == %{}, do: state.tree, else: Tree.merge(state.tree || %{}, tree)
    %{state | tree: tree, title: extras["t"] || state.title}
  end

  defp encode(join_ref, ref, topic, event, payload),
    do: {payload, Frame.encode(join_ref, ref, topic, event, payload)}

  defp pushed(%{response: response}), do: pushed(response)
  defp pushed(%{rendered: tree}), do: pushed(tree)
  defp pushed(%{diff: diff}), do: pushed(diff)
  defp pushed(%{e: events}), do: events
  defp pushed(_without), do: []

  defp patched(nil, state), do: state

  defp patched(%{"to" => to}, state) do
    send(state.owner, {__MODULE__, self(), :patch, to})
    %{state | url: state.url |> URI.merge(to) |> URI.to_string()}
  end

  defp told(target, state) do
    away = {"redirect", target}
    send(state.owner, {__MODULE__, self(), :away, away})
    %{state | away: away}
  end

  defp answer(state, ref, answer) do
    {from, waiting} = Map.pop(state.waiting, ref)
    # The join may be answered before the test asks about it.
    if from, do: GenServer.reply(from, answer)
    %{state | waiting: waiting}
  end
end
