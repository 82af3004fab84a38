defmodule Aerie.SlowLine do
  @moduledoc """
  A TCP proxy in front of a console: what the browser sends arrives at once, what the gateway answers reaches the browser late. `delay/2` says by
  how much, `hold/1` keeps everything on WebSockets back until `release/1`.

      line = start_supervised!({SlowLine, port: console.port})
      browse(%{console | url: SlowLine.url(line)}, "script.mjs")
  """
  use GenServer

  @doc false
  def start_link(options), do: GenServer.start_link(__MODULE__, options)

  @doc "The address for the browser."
  @spec url(pid()) :: String.t()
  def url(line), do: "http://127.0.0.1:#{GenServer.call(line, :port)}"

  @doc "Answers take so many milliseconds from now on."
  @spec delay(pid(), non_neg_integer()) :: :ok
  def delay(line, ms), do: GenServer.call(line, {:set, {:delay, ms}})

  @doc "WebSockets get nothing from now on."
  @spec hold(pid()) :: :ok
  def hold(line), do: GenServer.call(line, {:set, {:held, true}})

  @doc "WebSockets get what was kept back, and all that comes."
  @spec release(pid()) :: :ok
  def release(line), do: GenServer.call(line, {:set, {:held, false}})

  @impl GenServer
  def init(port: port) do
    {:ok, listener} = :gen_tcp.listen(0, [:binary, active: false, reuseaddr: true, ip: {127, 0, 0, 1}])
    line = self()
    spawn_link(fn -> accept(listener, line) end)
    {:ok, %{listener: listener, target: port, connections: [], delay: 0, held: false}}
  end

  defp accept(listener, line) do
    with {:ok, browser} <- :gen_tcp.accept(listener) do
      pid = spawn_link(fn -> receive do: ({:begin, state} -> connect(state)) end)
      :ok = :gen_tcp.controlling_process(browser, pid)
      send(line, {:accepted, pid, browser})
      accept(listener, line)
    end
  end

  @impl GenServer
  def handle_call(:port, _from, state) do
    {:ok, port} = :inet.port(state.listener)
    {:reply, port, state}
  end

  def handle_call({:set, {name, value}}, _from, state) do
    for pid <- state.connections, do: send(pid, {:set, name, value})
    {:reply, :ok, Map.put(state, name, value)}
  end

  @impl GenServer
  def handle_info({:accepted, pid, browser}, state) do
    begin = Map.take(state, [:target, :delay, :held])
    send(pid, {:begin, Map.merge(begin, %{browser: browser, late: :queue.new(), socket?: false})})
    {:noreply, %{state | connections: [pid | state.connections]}}
  end

  # The gateway may be away just now.
  defp connect(state) do
    case :gen_tcp.connect({127, 0, 0, 1}, state.target, [:binary, active: true]) do
      {:ok, gateway} ->
        :ok = :inet.setopts(state.browser, active: true)
        run(Map.put(state, :gateway, gateway))

      {:error, _away} ->
        :gen_tcp.close(state.browser)
    end
  end

  defp run(%{browser: browser, gateway: gateway} = state) do
    receive do
      {:tcp, ^browser, data} ->
        _closed_too = :gen_tcp.send(gateway, data)
        run(%{state | socket?: state.socket? or data =~ "/live/websocket"})

      {:tcp, ^gateway, data} ->
        Process.send_after(self(), :due, state.delay)
        run(%{state | late: :queue.in(data, state.late)})

      :due when state.held and state.socket? ->
        run(state)

      :due ->
        run(forward(state))

      {:set, :held, false} ->
        run(
          Enum.reduce(:queue.to_list(state.late), %{state | held: false}, fn _data, state ->
            forward(state)
          end)
        )

      {:set, name, value} ->
        run(Map.put(state, name, value))

      {:tcp_closed, _either} ->
        _ = Enum.reduce(:queue.to_list(state.late), state, fn _data, state -> forward(state) end)
        for socket <- [browser, gateway], do: :gen_tcp.close(socket)

      {:tcp_error, _either, _reason} ->
        for socket <- [browser, gateway], do: :gen_tcp.close(socket)
    end
  end

  # One for each that is due, in order: a shorter delay overtakes nothing.
  defp forward(state) do
    case :queue.out(state.late) do
      {{:value, data}, late} ->
        _closed_too = :gen_tcp.send(state.browser, data)
        %{state | late: late}

      {:empty, _late} ->
        state
    end
  end
end
