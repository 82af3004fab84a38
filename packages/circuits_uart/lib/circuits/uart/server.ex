defmodule Circuits.UART.Server do
  @moduledoc false
  # The process that serves a port. It decides nothing: calls, packets and timers become events for Circuits.UART.Core,
  # and the actions that come back are performed here. It never waits for anything.
  #
  # The first open starts the port program, which then stays. When it ends or is given up, the next open starts another one;
  # this process continues.

  use GenServer, restart: :permanent

  alias Circuits.UART.{Core, PortProgram, State, Wire}

  require Logger

  # How soon to try again when the port program did not read fast enough (ms).
  @busy_retry 2

  defstruct core: %State{}, path: nil, port: nil, timers: %{}, outbox: :queue.new(), told_missing: false

  @doc "Whether a process is such a server."
  @spec serves?(pid()) :: boolean()
  def serves?(pid) do
    case Process.info(pid, :dictionary) do
      {:dictionary, dictionary} ->
        List.keyfind(dictionary, :"$initial_call", 0) == {:"$initial_call", {__MODULE__, :init, 1}}

      nil ->
        false
    end
  end

  @impl GenServer
  def init(opts) do
    # The port is linked: its end is an event, and must not end this process.
    Process.flag(:trap_exit, true)
    Process.set_label({Circuits.UART, :closed})
    {:ok, %__MODULE__{path: Keyword.get_lazy(opts, :program, &PortProgram.path/0)}}
  end

  @impl GenServer
  def handle_call({:open, _path, _opts} = request, from, server) do
    case ensure_program(server) do
      {:ok, server} -> {:noreply, handle(server, {:call, from, request})}
      {:error, reason, server} -> {:reply, {:error, reason}, server}
    end
  end

  def handle_call(request, from, server), do: {:noreply, handle(server, {:call, from, request})}

  @impl GenServer
  def handle_info({port, {:data, packet}}, %{port: port} = server) when is_port(port) do
    case Wire.decode(packet) do
      :malformed ->
        Logger.error("the port program of a UART sent what is not a packet; it is given up")
        {:noreply, server |> stop_program() |> handle({:program_down, :epipe})}

      event ->
        {:noreply, handle(server, {:program, event})}
    end
  end

  def handle_info({port, {:exit_status, status}}, %{port: port} = server) when is_port(port) do
    {:noreply, program_ended(server, "status #{status}")}
  end

  # Its stdin was closed during a write; this may be noticed before its exit status.
  def handle_info({:EXIT, port, reason}, %{port: port} = server) when is_port(port) do
    {:noreply, program_ended(server, inspect(reason))}
  end

  def handle_info({:timer, :outbox}, server), do: {:noreply, send_outbox(server)}

  def handle_info({:timer, name, ref}, server) do
    case server.timers do
      %{^name => {^ref, _timer}} = timers ->
        {:noreply, handle(%{server | timers: Map.delete(timers, name)}, {:timer, name})}

      _cancelled_meanwhile ->
        {:noreply, server}
    end
  end

  # Another linked process: end as if exits were not trapped.
  def handle_info({:EXIT, pid, reason}, server) when is_pid(pid) and reason != :normal,
    do: {:stop, reason, server}

  def handle_info(_other, server), do: {:noreply, server}

  defp handle(server, event) do
    {core, actions} = Core.handle(server.core, event, System.monotonic_time(:millisecond))
    if core.name != server.core.name, do: Process.set_label({Circuits.UART, core.name})
    Enum.reduce(actions, %{server | core: core}, &perform/2)
  end

  defp perform({:reply, from, result}, server) do
    GenServer.reply(from, result)
    server
  end

  defp perform({:send, pid, id, data}, server) do
    send(pid, {:circuits_uart, message_id(id), data})
    server
  end

  defp perform({:command, packet}, server) do
    if :queue.is_empty(server.outbox), do: command(server, packet), else: put_outbox(server, packet)
  end

  defp perform({:start_timer, name, ms}, server) do
    server = cancel_timer(server, name)
    ref = make_ref()
    timer = Process.send_after(self(), {:timer, name, ref}, ms)
    %{server | timers: Map.put(server.timers, name, {ref, timer})}
  end

  defp perform({:cancel_timer, name}, server), do: cancel_timer(server, name)

  defp perform({:kill_program, name}, server) do
    Logger.error("the port program of UART #{inspect(name)} does not answer; it is given up")
    stop_program(server)
  end

  defp message_id(:pid), do: self()
  defp message_id({:name, name}), do: name

  defp cancel_timer(server, name) do
    case Map.pop(server.timers, name) do
      {nil, _timers} ->
        server

      {{_ref, timer}, timers} ->
        _ = Process.cancel_timer(timer)
        %{server | timers: timers}
    end
  end

  ## The port program

  defp ensure_program(%{port: nil} = server) do
    case PortProgram.start(server.path) do
      {:ok, port} -> {:ok, %{server | port: port}}
      {:error, reason} -> {:error, reason, tell_missing(server, reason)}
    end
  end

  defp ensure_program(server), do: {:ok, server}

  # Logged once, however often the open is tried again.
  defp tell_missing(%{told_missing: false} = server, :port_program_missing) do
    Logger.error(PortProgram.missing_message(server.path))
    %{server | told_missing: true}
  end

  defp tell_missing(server, _reason), do: server

  defp program_ended(server, how) do
    Logger.error("the port program of UART #{inspect(server.core.name)} ended (#{how})")
    server |> stop_program() |> handle({:program_down, :epipe})
  end

  defp stop_program(%{port: nil} = server), do: server

  defp stop_program(server) do
    PortProgram.stop(server.port)
    %{server | port: nil, outbox: :queue.new()}
  end

  # Without a program nothing is sent; the event of its end answers waiting callers.
  defp command(%{port: nil} = server, _packet), do: server

  defp command(server, packet) do
    case PortProgram.command(server.port, packet) do
      :busy -> put_outbox(server, packet)
      _ok_or_down -> server
    end
  end

  defp put_outbox(server, packet) do
    _ = if :queue.is_empty(server.outbox), do: Process.send_after(self(), {:timer, :outbox}, @busy_retry)
    %{server | outbox: :queue.in(packet, server.outbox)}
  end

  defp send_outbox(server) do
    packets = :queue.to_list(server.outbox)
    Enum.reduce(packets, %{server | outbox: :queue.new()}, &perform({:command, &1}, &2))
  end
end
