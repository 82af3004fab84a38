defmodule SimVehicle.Msp.Firmware do
  @moduledoc """
  Betaflight 4.5.5 (or, with `api: {1, 48}`, with the settings by name of 2026.6) or iNav 9.0.0, as far as MSP shows them: a value. What it says of its configuration is what the real one said in its
  simulator (`priv/msp`); what it says of its state is that of `SimVehicle.Msp.Flight`.

  It arms and changes its mode by the channels of its receiver, within the ranges of MODE_RANGES. Betaflight takes one request of each port
  in 10 ms, acknowledges short writes and fills them with stale bytes, restarts although it is armed, and dies of requests of 200 bytes and
  more. iNav answers at once, refuses wrong lengths, and refuses while it is armed what it should.
  """

  alias MavCodec.Msp.{Frame, Messages, Params}
  alias SimVehicle.Msp.{Blocks, Flight, Lines, Port, Receiver, Settings, Telemetry, Waypoints}

  @versions %{betaflight: {1, 46}, inav: {9, 0}}
  @tick_us 10_000
  @grace_us 5_000_000
  @off_us 1_500_000
  # {box, aux channel from 0, first and last step of 25 µs above 900}
  @ranges %{
    betaflight: [{0, 0, 32, 48}, {1, 1, 32, 48}, {46, 2, 32, 48}],
    inav: [{0, 0, 32, 48}, {1, 1, 32, 48}, {11, 2, 12, 28}, {10, 2, 32, 48}, {50, 3, 32, 48}, {31, 4, 32, 48}]
  }
  @arm 0
  @failsafe 27
  @gps_rescue 46
  @autopilot 56
  @throttle_low 1050
  # Until the flag, until the failsafe, after the last frame of the receiver.
  @lost_us %{betaflight: {150_000, 1_500_000}, inav: {200_000, 700_000}}
  @flags %{
    betaflight: %{
      failsafe: 1,
      rx: 2,
      not_disarmed: 3,
      throttle: 7,
      grace: 9,
      calibrating: 12,
      cli: 13,
      msp: 16,
      switch: 25
    },
    inav: %{failsafe: 7, calibrating: 9, switch: 14, rx: 18, throttle: 19, cli: 20}
  }
  @calibrates_us 2_000_000
  # Refused while armed by iNav; Betaflight refuses the first and ignores the others.
  @armed_inav [250, 205, 206, 68, 210, 0x2018, 0x2080, 18, 19, 208]

  defstruct [
    :firmware,
    :version,
    :blocks,
    now: 0,
    boots: 1,
    off_until: nil,
    dead: false,
    started: 0,
    flight: %Flight{},
    home_alt: 0.0,
    channels: [1500, 1500, 1000, 1500 | List.duplicate(1000, 12)],
    rc_at: 0,
    rc_lost: false,
    armed: false,
    boxes: MapSet.new([]),
    must_switch_off: false,
    calibrating_until: 0,
    stored: %{},
    settings: %{},
    mission: %Waypoints{},
    receiver: %Receiver{},
    rx_msp: false,
    blind: false,
    rescue_plan: false,
    ports: %{},
    events: []
  ]

  @type t :: %__MODULE__{}
  @type output :: {port :: term, binary}

  @doc """
  A flight controller that was just switched on. Options: `uid`, `flight`, `rx_msp` (MSP is its receiver), `mask` (of the channels that MSP may override),
  `api` (Betaflight's version of MSP), `blind` (it has neither a barometer nor a position),
  `rescue_plan` (Betaflight's rescue is flown as a plan: AUTOPILOT, and not GPS RESCUE).
  """
  @spec new(Messages.firmware(), keyword) :: t
  def new(firmware, options \\ []) do
    blocks = Map.put(Blocks.new(firmware), 34, ranges(firmware))
    flight = struct!(%Flight{}, Map.new(options[:flight] || %{}))
    # Each has another processor, which simulators of the real firmware have not.
    blocks = if uid = options[:uid], do: Map.put(blocks, 160, <<uid::32-little, 0::64>>), else: blocks

    rx_msp = options[:rx_msp] || false
    settings = if firmware == :inav, do: Settings.new(), else: %{}
    blocks = if firmware == :betaflight, do: Map.update!(blocks, 36, &feature(&1, rx_msp)), else: blocks

    settings =
      if firmware == :inav,
        do: Map.put(settings, "receiver_type", <<if(rx_msp, do: 2, else: 1)>>),
        else: settings

    blocks =
      if options[:rescue_plan], do: Map.update!(blocks, 119, &(&1 <> <<@autopilot, 11, 3>>)), else: blocks

    version = options[:api] || @versions[firmware]
    {blocks, settings} = if named?(firmware, version), do: named(blocks, version), else: {blocks, settings}

    %__MODULE__{
      rx_msp: rx_msp,
      blind: options[:blind] || false,
      rescue_plan: options[:rescue_plan] || false,
      receiver: %Receiver{mask: options[:mask] || 0},
      firmware: firmware,
      version: version,
      blocks: blocks,
      settings: settings,
      stored: %{blocks: blocks, settings: settings},
      flight: flight
    }
  end

  defp named?(firmware, version), do: firmware == :betaflight and Params.by_name?(firmware, version)

  defp named(blocks, {major, minor}) do
    text = "2026.6.1"
    about = %{1 => <<0, major, minor>>, 3 => <<26, 6, 1, byte_size(text), text::binary>>}
    {Map.merge(blocks, about), Lines.new()}
  end

  # RX_MSP, or RX_SERIAL.
  defp feature(<<features::32-little>>, msp?) do
    others = Bitwise.band(features, Bitwise.bnot(Bitwise.bsl(1, 14) + Bitwise.bsl(1, 3)))
    <<others + Bitwise.bsl(1, if(msp?, do: 14, else: 3))::32-little>>
  end

  defp ranges(firmware) do
    slots = %{betaflight: 20, inav: 40}[firmware]
    used = for {box, aux, first, last} <- @ranges[firmware], into: <<>>, do: <<box, aux, first, last>>
    used <> :binary.copy(<<0>>, 4 * slots - byte_size(used))
  end

  @doc "A client is at a port; what the one before left behind is still there."
  @spec connect(t, term) :: t
  def connect(fc, port), do: put_in(fc.ports[port], Map.get(fc.ports, port, %Port{}))

  @doc "Bytes from a client: what is answered at once."
  @spec receive(t, term, binary) :: {t, [output]}
  def receive(%{off_until: off} = fc, _port, _bytes) when off != nil, do: {fc, []}
  def receive(%{dead: true} = fc, _port, _bytes), do: {fc, []}

  def receive(fc, id, bytes) do
    {port, echo, events} = Port.receive(fc.ports[id], bytes)
    fc = Enum.reduce(events, put_in(fc.ports[id], port), &port_event/2)
    out = if echo == "", do: [], else: [{id, echo}]

    if fc.firmware == :inav and not port.cli do
      {fc, more} = serve(fc, id, length(port.queue))
      {fc, out ++ more}
    else
      {fc, out}
    end
  end

  defp port_event(:exit, fc), do: reboot(fc)
  # Its memory is overwritten.
  defp port_event({:oversize, n}, %{firmware: :betaflight} = fc) when n >= 200,
    do: event(%{fc | dead: true}, :crashed)

  defp port_event({:oversize, _n}, fc), do: fc

  @doc "Sets channels of its own receiver, in µs from the first on; it was heard now."
  @spec sticks(t, [integer]) :: t
  def sticks(fc, channels) do
    channels = Enum.take(channels ++ List.duplicate(1000, 16), 16)
    fc = %{fc | receiver: %{fc.receiver | pilot: channels}}
    if fc.rx_msp, do: fc, else: %{fc | channels: channels, rc_at: if(fc.rc_lost, do: fc.rc_at, else: fc.now)}
  end

  @doc "Loses its receiver, or finds it."
  @spec lose_rc(t, boolean) :: t
  def lose_rc(fc, lost?), do: %{fc | rc_lost: lost?}

  @doc "Lets time pass, in steps of 10 ms: what is answered."
  @spec step(t, us :: non_neg_integer) :: {t, [output]}
  def step(fc, us) when us < @tick_us, do: {fc, []}

  def step(fc, us) do
    {fc, out} = tick(%{fc | now: fc.now + @tick_us})
    {fc, more} = step(fc, us - @tick_us)
    {fc, out ++ more}
  end

  defp tick(%{off_until: off, now: now} = fc) when off != nil do
    if now >= off, do: {%{fc | off_until: nil, started: now}, []}, else: {fc, []}
  end

  defp tick(%{dead: true} = fc), do: {fc, []}

  defp tick(fc) do
    fc = if fc.rc_lost or fc.rx_msp, do: fc, else: %{fc | rc_at: fc.now}
    fc = %{fc | channels: Receiver.channels(override_switch(fc), fc.rx_msp, fc.boxes, fc.now)}
    fc = fc |> switches() |> fly()
    if fc.firmware == :betaflight, do: serve_all(fc), else: {fc, []}
  end

  # Its own channel is never overridden.
  defp override_switch(fc) do
    own = for <<50, aux, first, last <- fc.blocks[34]>>, first < last, do: Bitwise.bsl(1, 4 + aux)
    kept = Bitwise.bnot(Enum.sum(Enum.uniq(own)))
    %{fc.receiver | mask: Bitwise.band(fc.receiver.mask, kept)}
  end

  defp serve_all(fc) do
    Enum.reduce(Map.keys(fc.ports), {fc, []}, fn id, {fc, out} ->
      {fc, more} = serve(fc, id, 1)
      {fc, out ++ more}
    end)
  end

  defp fly(fc) do
    landing? = MapSet.member?(fc.boxes, @failsafe)
    flight = Flight.step(fc.flight, fc.channels, fc.armed, landing?, @tick_us / 1.0e6)
    %{fc | flight: flight}
  end

  # --- arming and modes ---

  defp switches(fc) do
    {_flag_us, failsafe_us} = @lost_us[fc.firmware]
    failsafe? = fc.now - fc.rc_at > failsafe_us
    wanted = wanted(fc)
    arm? = @arm in wanted
    was_armed = fc.armed

    fc =
      cond do
        fc.armed and failsafe? and fc.firmware == :betaflight -> %{fc | armed: false, must_switch_off: true}
        fc.armed and not arm? and not failsafe? -> %{fc | armed: false}
        not fc.armed and arm? and arming_flags(fc, false) == 0 -> %{fc | armed: true}
        not fc.armed and not arm? -> %{fc | must_switch_off: false}
        true -> fc
      end

    modes = if failsafe? and (was_armed or fc.armed), do: [@failsafe, 1], else: MapSet.delete(wanted, @arm)
    modes = if fc.rescue_plan and @gps_rescue in modes, do: [@autopilot, 11, 3, 1], else: modes
    boxes = MapSet.new(modes) |> then(&if fc.armed, do: MapSet.put(&1, @arm), else: &1)
    boxes = if failsafe? and fc.must_switch_off, do: MapSet.put(boxes, @failsafe), else: boxes
    %{changed(fc, was_armed) | boxes: boxes}
  end

  defp changed(%{armed: same} = fc, same), do: fc

  defp changed(%{armed: true} = fc, _was),
    do: event(%{fc | mission: Waypoints.armed(fc.mission, fc.flight), home_alt: fc.flight.alt}, :armed)

  defp changed(fc, _was), do: event(fc, :disarmed)

  defp wanted(fc) do
    for <<box, aux, first, last <- fc.blocks[34]>>,
        first < last,
        us = Enum.at(fc.channels, 4 + aux, 0),
        us >= 900 + 25 * first and us < 900 + 25 * last,
        into: MapSet.new(),
        do: box
  end

  @doc "The arming flags; the flag of the switch only counts if it is on."
  @spec arming_flags(t, boolean) :: non_neg_integer
  def arming_flags(fc, with_switch? \\ true) do
    {lost_us, failsafe_us} = @lost_us[fc.firmware]
    silent = fc.now - fc.rc_at

    grace? = fc.now - fc.started < @grace_us

    reasons = [
      # Betaflight looks for its receiver only after its first seconds.
      rx: silent > lost_us and (fc.firmware == :inav or not grace?),
      failsafe: silent > failsafe_us,
      not_disarmed: fc.must_switch_off,
      throttle: Enum.at(fc.channels, 2) > @throttle_low,
      grace: grace?,
      calibrating: fc.now < fc.calibrating_until,
      cli: Enum.any?(fc.ports, fn {_id, port} -> port.cli end),
      msp: Enum.any?(fc.ports, fn {_id, port} -> port.disabled end)
    ]

    bits = @flags[fc.firmware]

    flags =
      for {name, true} <- reasons,
          bit = bits[name],
          reduce: 0,
          do: (sum -> Bitwise.bor(sum, Bitwise.bsl(1, bit)))

    if with_switch? and flags != 0 and @arm in wanted(fc) and not fc.armed,
      do: Bitwise.bor(flags, Bitwise.bsl(1, bits.switch)),
      else: flags
  end

  # --- requests ---

  defp serve(fc, _id, 0), do: {fc, []}

  defp serve(fc, id, n) do
    case fc.ports[id] do
      %{queue: [frame | rest]} = port when fc.off_until == nil ->
        {answer, fc} = answer(put_in(fc.ports[id], %{port | queue: rest}), id, frame)
        {fc, more} = serve(fc, id, n - 1)
        # iNav does not answer if the lowest flag is set.
        silent? = fc.firmware == :inav and rem(frame.flags, 2) == 1
        {fc, if(silent?, do: [], else: out(id, frame, answer)) ++ more}

      _nothing ->
        {fc, []}
    end
  end

  defp out(id, frame, {:ok, payload}),
    do: [{id, Frame.encode(%{frame | direction: :reply, payload: payload})}]

  defp out(id, frame, :error), do: [{id, Frame.encode(%{frame | direction: :error, payload: ""})}]

  defp answer(%{firmware: :inav, armed: true} = fc, _id, %{id: command}) when command in @armed_inav,
    do: {:error, fc}

  defp answer(%{armed: true} = fc, _id, %{id: 250}), do: {:error, fc}
  # Acknowledged, and ignored.
  defp answer(%{armed: true} = fc, _id, %{id: command}) when command in [205, 206], do: {{:ok, ""}, fc}

  defp answer(fc, _id, %{id: 68, payload: payload}) do
    if payload in ["", <<0>>],
      do: {{:ok, if(fc.firmware == :inav, do: "", else: <<0>>)}, reboot(fc)},
      else: {:error, fc}
  end

  # Half a channel is acknowledged as well.
  defp answer(fc, _id, %{id: 200, payload: payload}) when byte_size(payload) <= 36 do
    receiver = Receiver.set(fc.receiver, payload, fc.blocks[64], fc.now)
    {{:ok, ""}, %{fc | receiver: receiver, rc_at: if(fc.rx_msp, do: fc.now, else: fc.rc_at)}}
  end

  defp answer(fc, _id, %{id: 250}),
    do: {{:ok, ""}, event(%{fc | stored: Map.take(fc, [:blocks, :settings])}, :stored)}

  defp answer(fc, _id, %{id: command}) when command in [205, 206],
    do: {{:ok, ""}, event(%{fc | calibrating_until: fc.now + @calibrates_us}, {:calibrating, command})}

  defp answer(%{firmware: :betaflight} = fc, id, %{id: 99, payload: <<disable, _::binary>>}) do
    fc = put_in(fc.ports[id].disabled, disable != 0)
    {{:ok, ""}, if(disable != 0, do: changed(%{fc | armed: false}, fc.armed), else: fc)}
  end

  defp answer(%{firmware: :betaflight} = fc, id, %{id: 230, payload: ids} = frame) do
    {parts, fc} =
      Enum.map_reduce(:binary.bin_to_list(ids), fc, fn inner, fc ->
        case answer(fc, id, %{frame | id: inner, payload: ""}) do
          {{:ok, payload}, fc} -> {<<rem(byte_size(payload), 256), payload::binary>>, fc}
          {_refused, fc} -> {<<0>>, fc}
        end
      end)

    {{:ok, IO.iodata_to_binary(parts)}, fc}
  end

  defp answer(%{firmware: :betaflight, version: version} = fc, _id, %{id: command, payload: payload})
       when version >= {1, 48} and command in [0x3010, 0x3011] do
    case Lines.answer(fc, command, payload) do
      {:ok, reply, changes} -> {{:ok, reply}, Map.merge(fc, changes)}
      :error -> {:error, fc}
    end
  end

  defp answer(fc, id, %{id: command, payload: payload} = frame) do
    case {Telemetry.payload(fc, command, arming_flags(fc)), Messages.fetch(fc.firmware, command)} do
      {payload, _message} when is_binary(payload) -> {{:ok, payload}, fc}
      {nil, {:ok, %{kind: :write} = message}} -> write(fc, id, message, frame)
      {nil, _read} -> {read(fc, command, payload), fc}
    end
  end

  defp read(%{firmware: :inav} = fc, 20, _none), do: {:ok, Waypoints.info(fc.mission)}
  defp read(%{firmware: :inav} = fc, 118, <<number>>), do: {:ok, Waypoints.get(fc.mission, number, fc.flight)}
  defp read(%{firmware: :inav} = fc, 118, _none), do: {:ok, Waypoints.get(fc.mission, 0, fc.flight)}
  defp read(%{firmware: :inav} = fc, 0x1003, name), do: Settings.get(fc.settings, name)
  defp read(%{firmware: :inav} = fc, 0x1007, name), do: Settings.info(fc.settings, name)

  defp read(fc, command, _arguments) do
    case fc.blocks do
      %{^command => payload} -> {:ok, payload}
      _unknown -> :error
    end
  end

  # A write whose layout is that of a block changes the block; others are acknowledged.
  defp write(%{firmware: :inav} = fc, _id, %{name: "MSP2_COMMON_SET_SETTING"}, %{payload: payload}) do
    case Settings.set(fc.settings, payload) do
      {:ok, settings} -> {{:ok, ""}, %{fc | settings: settings}}
      :error -> {:error, fc}
    end
  end

  defp write(%{firmware: :inav} = fc, _id, message, %{payload: payload}) do
    cond do
      message.exact? and byte_size(payload) not in message.sizes -> {:error, fc}
      message.name in ["WP_MISSION_SAVE", "WP_MISSION_LOAD", "SET_WP"] -> mission(fc, message.name, payload)
      true -> {{:ok, ""}, store(fc, message, payload)}
    end
  end

  defp write(fc, id, message, %{payload: payload}) do
    {filled, port} = Port.fill(fc.ports[id], payload, message.min)
    {{:ok, ""}, store(put_in(fc.ports[id], port), message, filled)}
  end

  defp mission(fc, "SET_WP", <<number, _action, place::binary-size(12), _::binary>>)
       when number in [0, 255] do
    takes? = fc.armed and 31 in fc.boxes and (number == 0 or 11 in fc.boxes)
    {{:ok, ""}, %{fc | mission: Waypoints.place(fc.mission, number, place, takes?)}}
  end

  defp mission(fc, "SET_WP", payload), do: {{:ok, ""}, %{fc | mission: Waypoints.set(fc.mission, payload)}}
  defp mission(fc, _name, ""), do: {:error, fc}
  defp mission(fc, "WP_MISSION_LOAD", _any), do: {{:ok, ""}, %{fc | mission: Waypoints.load(fc.mission)}}

  defp mission(fc, "WP_MISSION_SAVE", _any) do
    case Waypoints.save(fc.mission) do
      {:ok, mission} -> {{:ok, ""}, event(%{fc | mission: mission}, :mission_stored)}
      :error -> {:error, fc}
    end
  end

  defp store(fc, %{name: "SET_MODE_RANGE"}, <<slot, range::binary-size(4), _::binary>>) when slot < 20 do
    <<before::binary-size(^slot * 4), _old::binary-size(4), behind::binary>> = fc.blocks[34]
    put_in(fc.blocks[34], before <> range <> behind)
  end

  defp store(fc, message, payload),
    do: %{fc | blocks: Blocks.write(fc.blocks, fc.firmware, fc.version, message, payload)}

  defp reboot(fc) do
    ports = Map.new(fc.ports, fn {id, _port} -> {id, %Port{}} end)
    off = %{off_until: fc.now + @off_us, boots: fc.boots + 1, ports: ports, boxes: MapSet.new()}

    %{fc | armed: false, mission: Waypoints.restarted(fc.mission)}
    |> changed(fc.armed)
    |> Map.merge(fc.stored)
    |> Map.merge(off)
    |> event(:rebooted)
  end

  defp event(fc, event), do: %{fc | events: [event | fc.events]}
end
