defmodule Gnat.Connection do
  @moduledoc """
  The process of one connection: reads the socket and executes the actions of `Gnat.Session`.

  It starts with a connection that the server has accepted (`Gnat.Handshake`), so starting is quick and does
  not depend on the network. It stops with `{:shutdown, %Gnat.Error{}}` when the connection is lost.
  """

  use GenServer

  alias Gnat.{Command, Error, Handshake, Parsec, Session, Transport}

  require Logger

  # At most so many waiting calls that publish are written together.
  @batch 64

  @doc "Starts the process on an accepted connection that the caller owns, and hands it over."
  @spec start_link(Handshake.t(), GenServer.options()) :: {:ok, pid()} | {:error, {:already_started, pid()}}
  def start_link(%Handshake{transport: transport} = handshake, opts) do
    case GenServer.start_link(__MODULE__, handshake, opts) do
      {:ok, pid} ->
        # If the socket died meanwhile, its new owner finds out when it activates it.
        _ = Transport.give(transport, pid)
        GenServer.cast(pid, :activate)
        {:ok, pid}

      {:error, _} = error ->
        Transport.close(transport)
        error
    end
  end

  @impl GenServer
  def init(%Handshake{info: info, settings: settings} = handshake) do
    Process.set_label({:gnat, settings.host, settings.port})
    {session, [{:write, subscribe}]} = Session.new(info)

    # Before anybody can use the name: a request must not overtake the subscription for its answer. If this fails,
    # activating the socket fails too.
    _ = Transport.send(handshake.transport, subscribe)

    {:ok,
     %{
       transport: handshake.transport,
       parser: handshake.parser,
       session: session,
       headers: info[:headers] == true,
       ping_interval: settings.ping_interval,
       monitors: %{},
       last_server_error: nil
     }}
  end

  @impl GenServer
  def handle_cast(:activate, state) do
    schedule_tick(state)
    activate(state)
  end

  def handle_cast({:forget, inbox}, state), do: session({:forget, inbox}, state)

  @impl GenServer
  def handle_call({:pub, commands}, from, state) do
    calls =
      for {from, commands} <- [{from, commands} | waiting(@batch - 1)],
          do: {from, Enum.map(commands, &{elem(&1, 0), sendable(state, &1)})}

    writes = for {_from, commands} <- calls, {iodata, :ok} <- commands, do: iodata
    sent = if writes == [], do: :ok, else: Transport.send(state.transport, writes)

    for {from, commands} <- calls,
        do: GenServer.reply(from, for({_iodata, result} <- commands, do: with(:ok <- result, do: sent)))

    with {:error, error} <- sent, do: stop(error, state), else: (:ok -> {:noreply, state})
  end

  def handle_call({:sub, pid, subject, queue_group}, from, state) do
    session({:sub, from, pid, subject, queue_group}, state)
  end

  def handle_call({:unsub, sid}, from, state), do: event({:unsub, sid}, state, [{:reply, from, :ok}])

  def handle_call({:request, to, {topic, body, headers}}, {pid, _tag}, state) do
    {session, inbox, actions} = Session.request(state.session, to, pid)

    with {:ok, command, size} <- Command.pub(topic, body, inbox, headers),
         :ok <- sendable(state, {command, size, headers != []}) do
      with {:noreply, state} <-
             perform(actions ++ [{:write, command}], %{state | session: session}, &{:noreply, &1}) do
        {:reply, {:ok, inbox}, state}
      end
    else
      {:error, _} = error -> {:reply, error, state}
    end
  end

  def handle_call(:flush, from, state), do: session({:flush, from}, state)

  def handle_call(:active_subscriptions, _from, state),
    do: {:reply, {:ok, Session.subscriptions(state.session)}, state}

  def handle_call(:server_info, _from, state), do: {:reply, Session.info(state.session), state}
  def handle_call(:stop, _from, state), do: {:stop, :normal, :ok, state}

  @impl GenServer
  def handle_info(:tick, state) do
    schedule_tick(state)
    session(:tick, state)
  end

  def handle_info({:DOWN, _ref, :process, pid, _reason}, state) do
    session({:down, pid}, %{state | monitors: Map.delete(state.monitors, pid)})
  end

  def handle_info(message, state) do
    case Transport.message(state.transport, message) do
      {:data, bytes} -> data(bytes, state)
      :passive -> activate(state)
      {:closed, error} -> stop(error, state)
      # Late answers of calls that timed out, and the like.
      :unknown -> {:noreply, state}
    end
  end

  @impl GenServer
  def terminate(_reason, state), do: Transport.close(state.transport)

  defp data(bytes, state) do
    {session, []} = Session.handle(state.session, :heard)
    state = %{state | session: session}

    case Parsec.parse(state.parser, bytes) do
      {:ok, parser, messages} ->
        messages(messages, %{state | parser: parser}, &{:noreply, &1})

      {:error, why, messages} ->
        messages(messages, state, &stop(Error.new({:protocol, why}), &1))
    end
  end

  defp messages([], state, continue), do: continue.(state)

  defp messages([message | rest], state, continue) do
    {session, actions} = Session.handle(state.session, {:message, message})
    perform(actions, %{state | session: session}, &messages(rest, &1, continue))
  end

  defp session(event, state), do: event(event, state, [])

  defp event(event, state, more) do
    {session, actions} = Session.handle(state.session, event)
    perform(actions ++ more, %{state | session: session}, &{:noreply, &1})
  end

  defp perform([], state, continue), do: continue.(state)

  defp perform([action | rest], state, continue) do
    case action(action, state) do
      {:ok, state} -> perform(rest, state, continue)
      {:error, error} -> stop(error, state)
    end
  end

  defp action({:send, to, message}, state) do
    send(to, message)
    {:ok, state}
  end

  defp action({:write, iodata}, state) do
    with :ok <- Transport.send(state.transport, iodata), do: {:ok, state}
  end

  defp action({:reply, from, answer}, state) do
    GenServer.reply(from, answer)
    {:ok, state}
  end

  defp action({:monitor, pid}, state) do
    {:ok, %{state | monitors: Map.put(state.monitors, pid, Process.monitor(pid))}}
  end

  defp action({:demonitor, pid}, state) do
    {ref, monitors} = Map.pop!(state.monitors, pid)
    Process.demonitor(ref, [:flush])
    {:ok, %{state | monitors: monitors}}
  end

  # The same text is logged once, so that a refused permission does not fill the log.
  defp action({:server_error, text}, state) do
    :telemetry.execute([:gnat, :server_error], %{count: 1}, %{message: text})
    if text != state.last_server_error, do: Logger.error("NATS server reports: #{text}")
    {:ok, %{state | last_server_error: text}}
  end

  defp action({:stop, error}, _state), do: {:error, error}

  defp activate(state) do
    case Transport.activate(state.transport) do
      :ok -> {:noreply, state}
      {:error, error} -> stop(error, state)
    end
  end

  # If the server reported an error before it closed, that is the better reason. A refused permission closes nothing.
  defp stop(%Error{reason: :closed}, %{last_server_error: text} = state) when is_binary(text) do
    reason = if String.starts_with?(text, "Permissions Violation"), do: :closed, else: {:server, text}
    {:stop, {:shutdown, Error.new(reason)}, state}
  end

  defp stop(error, state), do: {:stop, {:shutdown, error}, state}

  # Calls that publish and are next in the mailbox.
  defp waiting(0), do: []

  defp waiting(left) do
    receive do
      {:"$gen_call", from, {:pub, commands}} -> [{from, commands} | waiting(left - 1)]
    after
      0 -> []
    end
  end

  defp sendable(%{headers: false}, {_iodata, _size, true}), do: {:error, Error.new(:headers_not_supported)}
  defp sendable(state, {_iodata, size, _headers?}), do: Session.check_size(state.session, size)

  defp schedule_tick(state), do: Process.send_after(self(), :tick, state.ping_interval)
end
