defmodule Aerie.Router.Forward do
  @moduledoc """
  From one endpoint to the others: what becomes of each frame of a read.

  | rule | |
  |---|---|
  | R1 | addressed to nobody or to all: to every other endpoint of the network; else where the addressee was heard |
  | R2 | never back to where it came from; an unknown addressee's frame goes nowhere |
  | R3, S10 | the bytes that go out are the bytes that came in, signature and all; only what a client with `sign` sends unsigned is signed by a link that needs it |
  | R4 | an unknown message goes to everyone |
  | R6 | a boot time that began anew clears the system's routes |
  | R9 | a component that never spoke is reached where its system is |
  | S8 | SETUP_SIGNING goes nowhere |
  | F10 | an addressee that was cut off is all |

  Runs in the process that received the frames. Order is kept for each receiver.
  """

  alias Aerie.Allowance
  alias Aerie.Mavlink.HighLatency
  alias Aerie.Router.Batch
  alias Aerie.Router.Carrier
  alias Aerie.Router.Classify
  alias Aerie.Router.Dedupe
  alias Aerie.Router.Filter
  alias Aerie.Router.Gate
  alias Aerie.Router.Out
  alias Aerie.Router.Plan
  alias Aerie.Router.Plan.Way
  alias Aerie.Router.RateLimit
  alias Aerie.Router.Renumber
  alias Aerie.Router.Routes
  alias Aerie.Router.Tables
  alias Aerie.Router.Talker
  alias Aerie.Router.Tally
  alias MavCodec.Frame

  @setup_signing 256
  # Heartbeats of one component that other vehicles hear: two a second, four at once.
  @beat_us 500_000
  @beats 4
  # What an autopilot says to itself: PX4 sends its own internal commands to 1/0 and 0/0.
  @orders [75, 76, 223, 224]

  @doc "Forwards frames of one talker, in order. `now` is monotonic ms."
  @spec frames(Tables.t(), Plan.t(), Way.t(), Talker.t(), [Frame.t()], integer) :: :ok
  def frames(_tables, _plan, %{role: :read_only} = way, _talker, frames, _now) do
    Tally.add(way.tally, :read_only, length(frames))
  end

  def frames(tables, plan, way, talker, frames, now) do
    if talker.other, do: Tally.add(way.tally, :collided, length(frames))

    case admitted(frames, tables, way, talker, now) do
      [] -> :ok
      frames -> guarded(frames, way, {tables, plan, way, talker, now})
    end
  end

  # Who may not command vehicles reaches them with what is no order only.
  defp guarded(frames, way, context) do
    if way.commands or Gate.free?(frames),
      do: run(frames, [], context),
      else: Enum.each(frames, &one(&1, context))
  end

  defp one(frame, {tables, plan, way, talker, now} = context) do
    if Gate.free?([frame]) do
      run([frame], [], context)
    else
      way = %{way | guarded: true}
      run([frame], [], {tables, plan, way, talker, now})
    end
  end

  # Nearly always there is nothing to look at.
  defp admitted(frames, _tables, %{in: nil} = way, %{twice: false}, _now) do
    if secrets?(frames), do: Enum.reject(frames, &secret?(&1, way)), else: frames
  end

  defp admitted(frames, tables, way, talker, now) do
    Enum.reject(frames, fn frame ->
      secret?(frame, way) or filtered_in?(frame, way) or duplicate?(frame, tables, way, talker, now)
    end)
  end

  defp secrets?([]), do: false
  defp secrets?([%{id: @setup_signing} | _rest]), do: true
  defp secrets?([_other | rest]), do: secrets?(rest)

  defp secret?(%{id: @setup_signing}, way), do: Tally.add(way.tally, :secret, 1) == :ok
  defp secret?(_frame, _way), do: false

  defp filtered_in?(frame, way),
    do: not Filter.pass?(way.in, frame, way.owner) and Tally.add(way.tally, :filtered_in, 1) == :ok

  defp duplicate?(_frame, _tables, _way, %{twice: false}, _now), do: false

  defp duplicate?(frame, tables, way, _talker, now),
    do: Dedupe.duplicate?(tables, frame.bytes, way.key, now) and Tally.add(way.tally, :duplicates, 1) == :ok

  # Broadcasts are gathered until somebody is addressed, so that each receiver gets everything in its order.
  defp run([], gathered, context), do: flush(gathered, context)

  defp run([frame | rest], gathered, context) do
    case target(frame, context) do
      :all ->
        run(rest, [frame | gathered], context)

      target ->
        flush(gathered, context)
        send_to(target, frame, context)
        run(rest, [], context)
    end
  end

  # Another vehicle's: to sniffers, whoever is addressed.
  defp target(_frame, {_tables, _plan, _way, %{other: true}, _now}), do: :all

  defp target(frame, {_tables, _plan, way, talker, _now}) do
    case Frame.target(frame) do
      nil ->
        :all

      {0, _component} when frame.id in @orders and talker.autopilot and way.side == :vehicle ->
        {frame.system, 0}

      {0, _component} ->
        :all

      target ->
        target
    end
  end

  defp flush([], _context), do: :ok

  defp flush([frame], {tables, plan, %{guarded: true} = way, talker, now}),
    do: flush([frame], {tables, plan, %{way | guarded: false}, Gate.narrow(talker, way, frame, tables), now})

  defp flush(gathered, {tables, _plan, way, talker, now}) do
    batch = to_everyone(talker.everyone, gathered |> :lists.reverse() |> Batch.new(), tables, way, now)
    _ = if talker.groups != [], do: to_groups(talker.groups, batch, tables, way, now)
    _ = if talker.heartbeats != [], do: only_heartbeats(talker, batch, tables, way, now)
    :ok
  end

  defp to_everyone([], batch, _tables, _way, _now), do: batch

  defp to_everyone([to | rest], batch, tables, way, now),
    do: to_everyone(rest, emit(to, batch, tables, way, now), tables, way, now)

  defp to_groups(groups, batch, tables, way, now) do
    for {group, ways} <- groups,
        {class, frames} <- classes(batch.frames),
        to <- pick(tables, group, ways, class) do
      emit(to, Batch.new(frames), tables, way, now)
    end
  end

  defp only_heartbeats(talker, batch, tables, way, now) do
    case Enum.filter(batch.frames, &(&1.id == 0 and beats?(talker, tables, way))) do
      [] -> :ok
      beats -> to_everyone(talker.heartbeats, Batch.new(beats), tables, way, now)
    end
  end

  # Each goes out as often as there are vehicles, so a sender has only so many.
  defp beats?(talker, tables, way) do
    key = {way.key, :beat, talker.system, talker.component}
    full = :ets.lookup_element(tables.limits, key, 2, nil)

    case Allowance.take(full, System.monotonic_time(:microsecond), @beat_us, @beats) do
      {:ok, full} -> :ets.insert(tables.limits, {key, full})
      :none -> false
    end
  end

  defp classes(frames) do
    frames |> Enum.chunk_by(&Classify.of(&1.id)) |> Enum.map(&{Classify.of(hd(&1).id), &1})
  end

  defp send_to(target, frame, {tables, plan, way, _talker, _now} = context) do
    {system, keys} = addressed(target, tables, plan, way)

    case Gate.open(keys, plan.ways, way, frame, target, tables) do
      :shut -> :ok
      keys -> send_by(frame, system, keys, context)
    end
  end

  defp send_by(frame, system, keys, {tables, _plan, way, talker, now} = context) do
    if not talker.twice, do: Dedupe.note(tables, frame.bytes, way.key, now)

    case meant(frame, system, way) do
      {:ok, frame} -> reach(frame, system, keys, context)
      :refused -> Tally.add(way.tally, :refused, 1)
    end
  end

  # A client that sees other ids says other ids.
  defp meant(frame, nil, _way), do: {:ok, frame}

  defp meant(frame, {_network, system}, %{renumber: offsets}) when offsets != nil,
    do: Renumber.inward(frame, system)

  defp meant(frame, _system, _way), do: {:ok, frame}

  defp reach(frame, system, keys, {tables, plan, way, talker, now}) do
    batch = Batch.new([frame])

    heard =
      for key <- keys, key != way.key, to = plan.ways[key], reach?(to, way, frame, talker, tables), do: to

    sniffers =
      for {key, %{sniffer: true} = to} <- plan.listeners,
          key != way.key,
          key not in keys,
          shares?(way, to),
          do: to

    case heard do
      # What is for us goes no further and has arrived.
      [] ->
        if Frame.target(frame) != plan.own, do: Tally.add(way.tally, :no_route, 1)

      heard ->
        heard |> one_of_each_group(system, frame, tables) |> Enum.each(&emit(&1, batch, tables, way, now))
    end

    Enum.each(sniffers, &emit(&1, batch, tables, way, now))
  end

  # Not within a group of redundant links, and not to the sender itself by another way: a vehicle would take its own words
  # for orders.
  defp reach?(to, way, frame, talker, tables) do
    (to.group == nil or to.group != way.group) and
      not (talker.twice and to.side == :vehicle and
             Enum.any?(way.networks, &Routes.talks?(tables, {&1, frame.system, frame.component}, to.key)))
  end

  # The first of the networks that the sender sees in which the addressee is known decides.
  defp addressed({id, component}, tables, plan, way) do
    Enum.find_value(way.networks, {nil, []}, fn network ->
      key = {network, Renumber.meant(way.renumber, network, id)}

      case component != 0 && Routes.ways(tables, key, component) do
        none when none in [false, []] ->
          if({id, component} != plan.own, do: some(key, Routes.ways(tables, key)))

        ways ->
          {key, ways}
      end
    end)
  end

  defp some(_key, []), do: nil
  defp some(key, ways), do: {key, ways}

  defp shares?(way, to), do: Enum.any?(way.networks, &(&1 in to.networks))

  defp one_of_each_group([_one] = ways, _system, _frame, _tables), do: ways

  defp one_of_each_group(ways, system, frame, tables) do
    {grouped, single} = Enum.split_with(ways, &(&1.group != nil and &1.side == :vehicle))
    class = Classify.of(frame.id)

    single ++
      Enum.flat_map(Enum.group_by(grouped, & &1.group), fn {group, ways} ->
        near = Carrier.within_reach(tables, system, Enum.map(ways, & &1.key))
        pick(tables, group, Enum.filter(ways, &(&1.key in near)), class)
      end)
  end

  defp pick(_tables, _group, [way], _class), do: [way]

  defp pick(tables, group, ways, class) do
    links = Carrier.links(tables, group, Enum.map(ways, & &1.owner), Carrier.configured(ways, class))
    Enum.filter(ways, &(&1.owner in links))
  end

  defp emit(%{plain: true} = to, batch, _tables, way, _now), do: out(to, batch, way)

  defp emit(to, batch, tables, way, _now) do
    # What passes here is a batch of its own, whose bytes no other way can use.
    _ =
      case batch.frames |> renumbered(to, way, tables) |> Enum.filter(&passes?(&1, to, tables, way)) do
        [] -> :ok
        frames -> out(to, Batch.new(frames), way)
      end

    batch
  end

  defp renumbered(frames, %{renumber: offsets} = to, %{side: :vehicle} = way, tables) when offsets != nil do
    theirs? = fn system -> Enum.any?(way.networks, &Routes.heard?(tables, {&1, system}, to.key)) end

    Enum.flat_map(frames, fn frame ->
      case Renumber.outward(offsets, way, frame, theirs?) do
        {:ok, frame} -> [frame]
        :refused -> refused(to)
      end
    end)
  end

  defp renumbered(frames, _to, _way, _tables), do: frames

  defp refused(way) do
    Tally.add(way.tally, :refused, 1)
    []
  end

  defp out(%{side: :vehicle} = to, batch, %{sign: true}), do: Out.to_be_signed(to, batch)
  defp out(to, batch, _way), do: Out.emit(to, batch)

  defp passes?(frame, to, tables, way) do
    cond do
      to.high_latency and not HighLatency.carries?(frame) -> Tally.add(to.tally, :spared, 1) != :ok
      not Filter.pass?(to.filter, frame, way.owner) -> Tally.add(to.tally, :filtered_out, 1) != :ok
      limited?(frame, to, tables) -> Tally.add(to.tally, :limited, 1) != :ok
      true -> true
    end
  end

  defp limited?(_frame, %{limits: nil}, _tables), do: false

  defp limited?(%{id: id} = frame, to, tables) do
    case to.limits do
      %{^id => interval} -> limited?(frame, to, interval, tables)
      _free -> false
    end
  end

  defp limited?(frame, to, interval, tables) do
    key = {to.key, frame.id, frame.system, frame.component}
    due = :ets.lookup_element(tables.limits, key, 2, nil)

    case RateLimit.pass(due, interval, System.monotonic_time(:microsecond)) do
      {:pass, due} -> not :ets.insert(tables.limits, {key, due})
      :drop -> true
    end
  end
end
