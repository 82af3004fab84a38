defmodule SimVehicle.Msp do
  @moduledoc """
  A simulated Betaflight or iNav flight controller that speaks MSP at a TCP port.

      {:ok, sim} = SimVehicle.Msp.start_link(firmware: :betaflight, port: 0, pilot: true)
      SimVehicle.Msp.port(sim)
      SimVehicle.Msp.sticks(sim, [1500, 1500, 1000, 1500, 1900])
      SimVehicle.Msp.await(sim, & &1.armed)

  Options: `firmware` (`:betaflight` or `:inav`), `port` (0: any free one; of 127.0.0.1), `pilot` (whether somebody flies it), `uid` (of the
  processor; real simulators all have the same one), `flight` (fields of `SimVehicle.Msp.Flight`), `rx_msp` and `mask` (`SimVehicle.Msp.Firmware.new/2`). `SimVehicle.Msp.Firmware` tells what it does.
  """
  use GenServer

  alias SimVehicle.Msp.{Firmware, Pilot}

  @tick_ms 10
  # Flight controllers have three ports for MSP.
  @ports 1..3

  @doc "Starts one, linked to the caller."
  @spec start_link(keyword) :: GenServer.on_start()
  def start_link(options), do: GenServer.start_link(__MODULE__, options, Keyword.take(options, [:name]))

  @doc false
  def child_spec(options), do: %{id: {__MODULE__, options[:uid]}, start: {__MODULE__, :start_link, [options]}}

  @doc "Its TCP port."
  @spec port(GenServer.server()) :: :inet.port_number()
  def port(sim), do: GenServer.call(sim, :port)

  @doc "The flight controller as it is (`t:SimVehicle.Msp.Firmware.t/0`)."
  @spec state(GenServer.server()) :: Firmware.t()
  def state(sim), do: GenServer.call(sim, :state)

  @doc "Sets the channels of its receiver."
  @spec sticks(GenServer.server(), [integer]) :: :ok
  def sticks(sim, channels), do: change(sim, &Firmware.sticks(&1, channels))

  @doc "Loses its receiver, or finds it."
  @spec lose_rc(GenServer.server(), boolean) :: :ok
  def lose_rc(sim, lost?), do: change(sim, &Firmware.lose_rc(&1, lost?))

  @doc "Changes the flight controller."
  @spec change(GenServer.server(), (Firmware.t() -> Firmware.t())) :: :ok
  def change(sim, fun), do: GenServer.call(sim, {:change, fun})

  @doc "Waits until the function of the flight controller is true, and returns it."
  @spec await(GenServer.server(), (Firmware.t() -> as_boolean(term)), timeout) :: term
  def await(sim, fun, timeout \\ 30_000), do: GenServer.call(sim, {:await, fun}, timeout)

  @impl GenServer
  def init(options) do
    case :gen_tcp.listen(options[:port] || 0, [:binary, active: false, reuseaddr: true, ip: {127, 0, 0, 1}]) do
      {:ok, listener} ->
        sim = self()
        acceptor = spawn_link(fn -> accept(listener, sim) end)
        Process.send_after(self(), :tick, @tick_ms)

        {:ok,
         %{
           fc: Firmware.new(options[:firmware] || :betaflight, options),
           listener: listener,
           acceptor: acceptor,
           pilot: options[:pilot],
           clock: now(),
           waiters: [],
           sockets: %{}
         }}

      {:error, reason} ->
        {:stop, {:listen, reason}}
    end
  end

  defp accept(listener, sim) do
    with {:ok, socket} <- :gen_tcp.accept(listener) do
      :ok = :gen_tcp.controlling_process(socket, sim)
      send(sim, {:connected, socket})
      accept(listener, sim)
    end
  end

  @impl GenServer
  def handle_call(:port, _from, state), do: {:reply, elem(:inet.port(state.listener), 1), state}
  def handle_call(:state, _from, state), do: {:reply, state.fc, state}
  def handle_call({:change, fun}, _from, state), do: {:reply, :ok, %{state | fc: fun.(state.fc)}}

  def handle_call({:await, fun}, from, state),
    do: {:noreply, wake(%{state | waiters: [{from, fun} | state.waiters]})}

  @impl GenServer
  def handle_info({:connected, socket}, state) do
    case Enum.find(@ports, &(not is_map_key(state.sockets, &1))) do
      nil ->
        :gen_tcp.close(socket)
        {:noreply, state}

      port ->
        _ = :inet.setopts(socket, active: true, nodelay: true)

        {:noreply,
         %{state | fc: Firmware.connect(state.fc, port), sockets: Map.put(state.sockets, port, socket)}}
    end
  end

  def handle_info({:tcp, socket, bytes}, state) do
    {port, _socket} = Enum.find(state.sockets, fn {_port, known} -> known == socket end)
    {fc, out} = Firmware.receive(state.fc, port, bytes)
    write(state, out)
    {:noreply, wake(%{state | fc: fc})}
  end

  def handle_info({:tcp_closed, socket}, state),
    do: {:noreply, %{state | sockets: Map.reject(state.sockets, fn {_port, known} -> known == socket end)}}

  def handle_info({:tcp_error, _socket, _reason}, state), do: {:noreply, state}

  def handle_info(:tick, state) do
    Process.send_after(self(), :tick, @tick_ms)
    passed = div(now() - state.clock, 10_000) * 10_000
    fc = if state.pilot, do: Firmware.sticks(state.fc, Pilot.channels(state.fc.now)), else: state.fc
    {fc, out} = Firmware.step(fc, passed)
    write(state, out)
    {:noreply, wake(%{state | fc: fc, clock: state.clock + passed})}
  end

  # A client that is gone gets nothing.
  defp write(%{sockets: sockets}, out) do
    Enum.each(out, fn {port, bytes} -> if socket = sockets[port], do: :gen_tcp.send(socket, bytes) end)
  end

  defp wake(state) do
    waiting =
      Enum.reject(state.waiters, fn {from, fun} ->
        if(result = fun.(state.fc), do: GenServer.reply(from, result))
      end)

    %{state | waiters: waiting}
  end

  defp now, do: :erlang.monotonic_time(:microsecond)
end
