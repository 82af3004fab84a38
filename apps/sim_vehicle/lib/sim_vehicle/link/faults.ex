defmodule SimVehicle.Link.Faults do
  @moduledoc """
  Simulates a bad link as a pure function: the same seed and frames give the same faults.

  | fault | value | effect |
  |---|---|---|
  | `:loss` | 0.0..1.0 | that share of the frames is dropped |
  | `:duplicate` | 0.0..1.0 | that share is sent twice |
  | `:reorder` | 0.0..1.0 | that share is held and sent after the frame that follows it |
  | `:corrupt` | 0.0..1.0 | one bit is flipped in that share |
  | `:delay` | ms or `{ms, jitter_ms}` | every frame is delayed by ms, plus 0..jitter |
  | `:silence` | true/false | nothing is sent; the vehicle flies on and still receives |
  | `:deaf` | true/false | nothing is received; the vehicle still sends |
  | `:half_open` | true/false | nothing is sent or received, while the connection stays open (a dead peer behind TCP) |

  Loss, duplication, reordering, corruption and delay are set for each direction: `:out` (from the vehicle, the
  default) and `:in`. At most 2000 frames are held back; more are dropped and counted.
  """

  @held_max 2000
  @shares [:loss, :duplicate, :reorder, :corrupt]
  @switches [:silence, :deaf, :half_open]

  defstruct rand: nil,
            out: %{},
            in: %{},
            switches: MapSet.new(),
            held: %{out: nil, in: nil},
            pending: 0,
            counts: %{out: %{}, in: %{}}

  @type t :: %__MODULE__{}
  @type direction :: :out | :in

  @doc "A perfect link whose later faults are drawn from `seed`."
  @spec new(integer) :: t
  def new(seed), do: %__MODULE__{rand: :rand.seed_s(:exsss, seed)}

  @doc "Sets a fault; `{:error, text}` says what was expected."
  @spec set(t, atom, term, direction) :: {:ok, t} | {:error, String.t()}
  def set(faults, name, share, direction)
      when name in @shares and is_number(share) and share >= 0 and share <= 1 and direction in [:out, :in] do
    {:ok, put(faults, direction, name, share)}
  end

  def set(faults, :delay, ms, direction) when is_integer(ms), do: set(faults, :delay, {ms, 0}, direction)

  def set(faults, :delay, {ms, jitter} = delay, direction)
      when is_integer(ms) and ms >= 0 and is_integer(jitter) and jitter >= 0 and direction in [:out, :in] do
    {:ok, put(faults, direction, :delay, delay)}
  end

  def set(faults, name, on, _direction) when name in @switches and is_boolean(on) do
    switches = if on, do: MapSet.put(faults.switches, name), else: MapSet.delete(faults.switches, name)
    {:ok, %{faults | switches: switches}}
  end

  def set(_faults, name, value, direction) do
    {:error,
     "expected a fault of #{inspect(@shares ++ [:delay] ++ @switches)} with its value (see SimVehicle.Link.Faults) and direction :out or :in, " <>
       "got: #{inspect(name)} = #{inspect(value)}, #{inspect(direction)}"}
  end

  @doc "Applies the faults to one frame: a list of `{delay_ms, bytes}` in sending order, empty if the frame is lost."
  @spec pass(t, direction, binary) :: {[{non_neg_integer, binary}], t}
  def pass(faults, direction, bytes) do
    settings = Map.fetch!(faults, direction)
    faults = count(faults, direction, :offered)

    cond do
      shut?(faults, direction) -> {[], count(faults, direction, :silenced)}
      settings == %{} and faults.held[direction] == nil -> {[{0, bytes}], count(faults, direction, :passed)}
      true -> gauntlet(faults, direction, settings, bytes)
    end
  end

  @doc "Counts frames that a caller holds for a delay (`n`), or has released (`-n`)."
  @spec pending(t, integer) :: t
  def pending(faults, n), do: %{faults | pending: faults.pending + n}

  defp gauntlet(faults, direction, settings, bytes) do
    {lost?, faults} = draw(faults, settings[:loss])

    if lost? do
      {[], count(faults, direction, :lost)}
    else
      {bytes, faults} = corrupt(faults, direction, settings, bytes)
      {twice?, faults} = draw(faults, settings[:duplicate])
      faults = if twice?, do: count(faults, direction, :duplicated), else: faults
      copies = if twice?, do: [bytes, bytes], else: [bytes]
      {ordered, faults} = reorder(faults, direction, settings, copies)
      delay(faults, direction, settings, ordered)
    end
  end

  defp reorder(faults, direction, settings, copies) do
    {hold?, faults} = draw(faults, settings[:reorder])

    case faults.held[direction] do
      nil when hold? ->
        {[], %{faults | held: %{faults.held | direction => copies}} |> count(direction, :reordered)}

      nil ->
        {copies, faults}

      held ->
        {copies ++ held, %{faults | held: %{faults.held | direction => nil}}}
    end
  end

  defp delay(faults, direction, settings, frames) do
    Enum.flat_map_reduce(frames, faults, fn bytes, faults ->
      {ms, faults} = delay_ms(faults, settings[:delay])

      if ms > 0 and faults.pending >= @held_max,
        do: {[], count(faults, direction, :overflow)},
        else: {[{ms, bytes}], count(faults, direction, :passed)}
    end)
  end

  defp delay_ms(faults, nil), do: {0, faults}
  defp delay_ms(faults, {ms, 0}), do: {ms, faults}

  defp delay_ms(faults, {ms, jitter}) do
    {extra, rand} = :rand.uniform_s(jitter + 1, faults.rand)
    {ms + extra - 1, %{faults | rand: rand}}
  end

  defp corrupt(faults, direction, settings, bytes) do
    {hit?, faults} = draw(faults, settings[:corrupt])

    if hit? and bytes != "" do
      {bit, rand} = :rand.uniform_s(bit_size(bytes), faults.rand)
      skip = bit - 1
      <<head::size(^skip), one::1, tail::bitstring>> = bytes

      {<<head::size(skip), 1 - one::1, tail::bitstring>>,
       count(%{faults | rand: rand}, direction, :corrupted)}
    else
      {bytes, faults}
    end
  end

  defp draw(faults, share) when share in [nil, 0, 0.0], do: {false, faults}

  defp draw(faults, share) do
    {x, rand} = :rand.uniform_s(faults.rand)
    {x < share, %{faults | rand: rand}}
  end

  defp shut?(faults, direction) do
    MapSet.member?(faults.switches, :half_open) or
      MapSet.member?(faults.switches, if(direction == :out, do: :silence, else: :deaf))
  end

  defp put(faults, direction, name, value) do
    Map.update!(faults, direction, fn settings ->
      if value in [0, 0.0, {0, 0}], do: Map.delete(settings, name), else: Map.put(settings, name, value)
    end)
  end

  defp count(faults, direction, what) do
    counts = Map.update!(faults.counts, direction, &Map.update(&1, what, 1, fn n -> n + 1 end))
    %{faults | counts: counts}
  end
end
