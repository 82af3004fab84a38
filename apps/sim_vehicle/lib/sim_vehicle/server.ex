defmodule SimVehicle.Server do
  @moduledoc """
  The process of one simulated vehicle: real time and sockets around `SimVehicle.Vehicle`.

  It performs actions, advances time, parses and encodes, and puts `SimVehicle.Link.Faults` between vehicle and socket.
  The public functions are in `SimVehicle`.
  """

  use GenServer, restart: :transient

  alias MavCodec.Parser
  alias SimVehicle.{Link, Pilot, Vehicle}
  alias SimVehicle.Link.{Faults, Signing}
  alias SimVehicle.Server.Simulation
  alias SimVehicle.Vehicle.View

  # After a pause of the whole machine, a vehicle catches up with at most this much time.
  @catch_up_s 0.5
  # At high speed that is a long time. Its script and those who wait for something see all of it.
  @slice_s 1.0
  @tick_min_ms 5
  @tick_max_ms 40
  @reboot_us 1_000_000
  @boot_bytes_max 4096

  @dialects %{
    ardupilot: MavCodec.Dialects.Ardupilot,
    ardurover: MavCodec.Dialects.Ardupilot,
    px4: MavCodec.Dialects.Upstream
  }

  defstruct [
    :vehicle,
    :link,
    :parser,
    :faults,
    :pilot,
    :options,
    :dialect,
    :clock,
    :off_for,
    :signing,
    seq: %{},
    frozen: false,
    datagrams: true,
    boot_bytes: "",
    subscribers: %{},
    waiters: [],
    sent: 0,
    unsent: 0,
    received: 0,
    refused: 0
  ]

  @doc false
  def start_link(options) do
    GenServer.start_link(__MODULE__, options, if(options.name, do: [name: options.name], else: []))
  end

  @impl GenServer
  def init(options) do
    Process.flag(:trap_exit, true)
    Process.set_label({:sim_vehicle, options.firmware, options.system})
    dialect = Map.fetch!(@dialects, options.firmware)

    case Link.open(options.address) do
      {:ok, link} ->
        state = %__MODULE__{
          vehicle: Vehicle.new(options),
          link: link,
          parser: Parser.new(dialects: [dialect]),
          faults: Faults.new(options.seed),
          pilot: options.script && Pilot.new(options.script),
          options: options,
          dialect: dialect,
          signing: Signing.new(options.key, options.secure, options.firmware, options.signed_at),
          datagrams: String.starts_with?(options.link, "udp"),
          clock: System.monotonic_time(:microsecond)
        }

        {:ok, state |> boot() |> schedule()}

      {:error, reason} ->
        {:stop, {:link, options.link, reason}}
    end
  end

  @impl GenServer
  def handle_call({:fault, name, value, direction}, _from, state), do: fault(state, name, value, direction)
  def handle_call(:state, _from, state), do: {:reply, view(state), state}
  def handle_call(:port, _from, state), do: {:reply, Link.port(state.link), state}

  def handle_call(:stats, _from, state) do
    stats = %{
      sent: state.sent,
      unsent: state.unsent,
      received: state.received,
      refused: state.refused,
      faults: state.faults.counts,
      parser: Parser.stats(state.parser)
    }

    {:reply, stats, state}
  end

  def handle_call({:handle, event}, _from, state), do: {:reply, :ok, apply_event(state, event)}
  def handle_call(:reboot, _from, state), do: {:reply, :ok, apply_event(state, :reboot)}

  def handle_call({:subscribe, pid}, _from, state) do
    subscribers = Map.put_new_lazy(state.subscribers, pid, fn -> Process.monitor(pid) end)
    {:reply, :ok, %{state | subscribers: subscribers}}
  end

  def handle_call({:await, fun}, from, state),
    do: {:noreply, wake(%{state | waiters: [{from, fun} | state.waiters]})}

  @impl GenServer
  def handle_info(:tick, state), do: {:noreply, state |> pass_time() |> wake() |> schedule()}

  def handle_info({:deliver, bytes}, state) do
    state = %{state | faults: Faults.pending(state.faults, -1)}
    {:noreply, if(state.off_for, do: state, else: put_on_wire(state, bytes))}
  end

  def handle_info({:hear, bytes}, state) do
    {:noreply, wake(hear(%{state | faults: Faults.pending(state.faults, -1)}, bytes))}
  end

  def handle_info({:DOWN, _ref, :process, pid, _reason}, state),
    do: {:noreply, %{state | subscribers: Map.delete(state.subscribers, pid)}}

  def handle_info({:EXIT, _pid, reason}, state) when reason in [:normal, :shutdown], do: {:noreply, state}
  def handle_info({:EXIT, _pid, reason}, state), do: {:stop, reason, state}

  def handle_info(message, state) do
    case Link.handle(state.link, message) do
      {:data, bytes, link} -> {:noreply, %{state | link: link} |> first_contact() |> arrived(bytes) |> wake()}
      {:up, link} -> {:noreply, %{state | link: link, parser: fresh_parser(state)} |> first_contact()}
      {:down, link} -> {:noreply, %{state | link: link}}
      {:ok, link} -> {:noreply, %{state | link: link}}
      :unknown -> {:noreply, state}
    end
  end

  @impl GenServer
  def terminate(_reason, state), do: Link.close(state.link)

  # --- time ---

  defp schedule(state) do
    Process.send_after(self(), :tick, tick_ms(state.vehicle.streams, state.options.speed))
    state
  end

  # Twice as often as the fastest stream, so that its rate is right without stepping faster than needed.
  defp tick_ms(streams, speed) do
    fastest = streams.intervals |> Map.values() |> Enum.min(fn -> 1_000_000 end)
    round(fastest / 2000 / speed) |> max(@tick_min_ms) |> min(@tick_max_ms)
  end

  defp pass_time(state) do
    now = System.monotonic_time(:microsecond)
    elapsed = min((now - state.clock) / 1.0e6, @catch_up_s) * state.options.speed
    advance(%{state | clock: now}, elapsed)
  end

  defp advance(state, elapsed) when elapsed > @slice_s,
    do: state |> advance(@slice_s) |> wake() |> advance(elapsed - @slice_s)

  defp advance(%{frozen: true} = state, _elapsed), do: state

  defp advance(%{off_for: left} = state, elapsed) when left != nil do
    left = left - round(elapsed * 1.0e6)
    if left <= 0, do: boot(%{state | off_for: nil}), else: %{state | off_for: left}
  end

  defp advance(state, elapsed) do
    {vehicle, actions} = Simulation.step(state.vehicle, elapsed)
    signing = Signing.tick(state.signing, vehicle.now)
    %{state | vehicle: vehicle, signing: signing} |> interpret(actions) |> fly_script()
  end

  defp fly_script(%{pilot: nil} = state), do: state

  defp fly_script(state) do
    {pilot, orders} = Pilot.step(state.pilot, state.vehicle)
    Enum.reduce(orders, %{state | pilot: pilot}, &apply_event(&2, &1))
  end

  defp boot(state) do
    {vehicle, actions} = Simulation.boot(state.vehicle, System.os_time(:microsecond))
    interpret(%{state | vehicle: vehicle, seq: %{}, boot_bytes: ""}, actions)
  end

  # --- actions ---

  defp apply_event(%{off_for: left} = state, _event) when left != nil, do: state

  defp apply_event(state, event) do
    {vehicle, actions} = Simulation.handle(state.vehicle, event)
    wake(interpret(%{state | vehicle: vehicle}, actions))
  end

  defp interpret(state, actions), do: Enum.reduce(actions, state, &do_action(&2, &1))

  # Each component counts its own frames.
  defp do_action(state, {:send, {component, message}}), do: encode(state, message, component)
  defp do_action(state, {:send, message}), do: encode(state, message, state.vehicle.component)

  # Boot text without a listener is kept for the first connection, as SITL that waits for its console does.
  defp do_action(state, {:bytes, bytes}) do
    kept = binary_part(bytes, 0, min(byte_size(bytes), @boot_bytes_max))

    case Link.send_bytes(state.link, kept) do
      {:sent, link} -> %{state | link: link}
      {:dropped, link} -> %{state | link: link, boot_bytes: kept}
    end
  end

  defp do_action(state, {:notify, event}) do
    notify(state, event)
    %{state | pilot: state.pilot && Pilot.notified(state.pilot, event)}
  end

  defp do_action(state, :reboot),
    do: %{
      state
      | link: Link.drop(state.link),
        parser: fresh_parser(state),
        signing: Signing.rebooted(state.signing),
        off_for: @reboot_us
    }

  defp notify(state, event),
    do: Enum.each(state.subscribers, fn {pid, _ref} -> send(pid, {:sim, self(), event}) end)

  defp encode(state, message, component) do
    if state.options.mavlink == 1 and not version_1?(state, message) do
      state
    else
      seq = Map.get(state.seq, component, 0)

      bytes =
        MavCodec.encode(message,
          system: state.vehicle.system,
          component: component,
          seq: seq,
          version: version(state, message, seq),
          dialect: state.dialect
        )

      {bytes, signing} = Signing.sign(state.signing, bytes, message, state.dialect)
      transmit(%{state | seq: Map.put(state.seq, component, rem(seq + 1, 256)), signing: signing}, bytes)
    end
  end

  # Version 1 has no mission_type: a fence would be a mission in it.
  defp version(%{options: %{mavlink: :both}}, %{mission_type: type}, _seq) when type != 0, do: 2

  defp version(%{options: %{mavlink: :both}} = state, message, seq),
    do: if(version_1?(state, message), do: 1 + rem(seq, 2), else: 2)

  defp version(state, _message, _seq), do: state.options.mavlink

  defp version_1?(state, %module{}),
    do: match?({id, _crc, _base, _ext} when id < 256, state.dialect.layout(module))

  defp transmit(state, bytes) do
    {deliveries, faults} = Faults.pass(state.faults, :out, bytes)
    Enum.reduce(deliveries, %{state | faults: faults}, &deliver(&2, &1, :deliver))
  end

  defp deliver(state, {0, bytes}, :deliver), do: put_on_wire(state, bytes)
  defp deliver(state, {0, bytes}, :hear), do: hear(state, bytes)

  defp deliver(state, {ms, bytes}, what) do
    Process.send_after(self(), {what, bytes}, ms)
    %{state | faults: Faults.pending(state.faults, 1)}
  end

  defp put_on_wire(state, bytes) do
    case Link.send_bytes(state.link, bytes) do
      {:sent, link} -> %{state | link: link, sent: state.sent + 1}
      {:dropped, link} -> %{state | link: link, unsent: state.unsent + 1}
    end
  end

  # --- what arrives ---

  defp first_contact(%{boot_bytes: ""} = state), do: state

  defp first_contact(state) do
    case Link.send_bytes(state.link, state.boot_bytes) do
      {:sent, link} -> %{state | link: link, boot_bytes: ""}
      {:dropped, link} -> %{state | link: link}
    end
  end

  defp arrived(state, bytes) do
    {deliveries, faults} = Faults.pass(state.faults, :in, bytes)
    Enum.reduce(deliveries, %{state | faults: faults}, &deliver(&2, &1, :hear))
  end

  # A hung or unpowered vehicle loses its input.
  defp hear(%{frozen: true} = state, _bytes), do: state
  defp hear(%{off_for: left} = state, _bytes) when left != nil, do: state

  defp hear(state, bytes) do
    push = if state.datagrams, do: &Parser.push_datagram/3, else: &Parser.push/3
    {frames, parser} = push.(state.parser, bytes, nil)
    Enum.reduce(frames, %{state | parser: parser}, &frame(&2, &1))
  end

  defp frame(state, frame) do
    state = %{state | received: state.received + 1}

    case Signing.check(state.signing, frame) do
      {:ok, signing} -> accepted(%{state | signing: signing}, frame)
      {:refused, signing} -> %{state | signing: signing, refused: state.refused + 1}
    end
  end

  defp accepted(state, frame) do
    case MavCodec.decode(frame, state.dialect) do
      {:ok, %MavCodec.Messages.SetupSigning{} = setup} ->
        %{state | signing: Signing.setup(state.signing, setup, state.vehicle)}

      {:ok, message} ->
        source = {frame.system, frame.component}
        state = %{state | pilot: state.pilot && Pilot.overheard(state.pilot, message, state.vehicle)}
        notify(state, {:heard, message, source})
        apply_event(state, {:message, message, source})

      {:error, _unknown} ->
        state
    end
  end

  defp fresh_parser(state), do: Parser.new(dialects: [state.dialect])

  # --- faults, waiters ---

  defp fault(state, :freeze, on, _direction) when is_boolean(on), do: {:reply, :ok, %{state | frozen: on}}

  defp fault(state, :clock_jump, seconds, _direction) when is_number(seconds),
    do: {:reply, :ok, apply_event(state, {:clock_jump, seconds})}

  defp fault(state, :drop, true, _direction), do: {:reply, :ok, %{state | link: Link.drop(state.link)}}

  defp fault(state, name, value, direction) do
    case Faults.set(state.faults, name, value, direction) do
      {:ok, faults} -> {:reply, :ok, %{state | faults: faults}}
      {:error, text} -> {:reply, {:error, text}, state}
    end
  end

  defp wake(%{waiters: []} = state), do: state

  defp wake(state) do
    view = view(state)

    waiting =
      Enum.reject(state.waiters, fn {from, fun} ->
        result = fun.(view)
        if result, do: GenServer.reply(from, result)
        result
      end)

    %{state | waiters: waiting}
  end

  defp view(state) do
    state.vehicle
    |> View.of()
    |> Map.merge(%{
      frozen: state.frozen,
      off: state.off_for != nil,
      sent: state.sent,
      received: state.received
    })
  end
end
