defmodule MavCodec.Message.BootClock do
  @tolerance_ms 2_000
  @readings 3
  @span_us 1_000_000
  # Simulators run up to 100 times faster than time.
  @too_fast 200

  @moduledoc """
  Follows the clock of one component of a vehicle (`time_boot_ms`) and tells when it starts over: a reboot (R6). A pure value.

  Each kind of message has a clock of its own, because firmware fills the field differently: Betaflight's GLOBAL_POSITION_INT has
  microseconds in it, its ATTITUDE milliseconds. Clocks are compared with the time of arrival. One that runs at least #{@too_fast}
  times too fast is not a clock; as soon as one clock has kept time, only those that keep time count.

  A clock that falls more than #{div(@tolerance_ms, 1_000)} s behind means a reboot only if it stays behind: #{@readings} readings in
  a row, over at least #{div(@span_us, 1_000_000)} s. Frames that were overtaken (by a slower second link, or PX4's two sending
  threads) show an old time between new ones, which is not a reboot. Nor is the 32-bit wrap after 49.7 days; in a silence the
  clock shows what it would after that time.
  """

  import Bitwise

  @enforce_keys [:seed]
  defstruct [:seed, :seed_at, clocks: %{}, proven: false]

  @wrap 0x100000000
  @half 0x80000000
  # A quartz is better than a thousandth.
  @drift 1_000
  @day_ms 86_400_000
  # How long a clock runs before its pace is judged, and how often in a row it has to be too fast: two vehicles with one id jump to
  # and fro.
  @pace_us 500_000
  @strikes 3

  @typep clock :: %{
           newest: non_neg_integer() | nil,
           newest_at: integer() | nil,
           behind: nil | {pos_integer(), since :: integer(), boot_ms :: non_neg_integer()},
           from: {at :: integer(), boot_ms :: non_neg_integer()},
           pace: :unknown | :good | non_neg_integer()
         }
  @typedoc """
  `seed`: the last value of a clock that was not read yet, at `seed_at`; `pace`: a number tells how often in a row it
  was too fast.
  """
  @type t :: %__MODULE__{
          seed: non_neg_integer() | nil,
          seed_at: integer() | nil,
          clocks: %{non_neg_integer() => clock()},
          proven: boolean()
        }
  @type verdict :: :ok | :behind | :reboot | :none

  @doc "A clock that last showed `boot_ms`, `at` a time (µs), or never."
  @spec new(non_neg_integer() | nil, integer() | nil) :: t()
  def new(boot_ms \\ nil, at \\ nil), do: %__MODULE__{seed: boot_ms, seed_at: at}

  @doc """
  Whether a clock that showed `last` and now shows less has wrapped, as far as that alone tells: within a day of it.
  """
  @spec wrapped?(non_neg_integer(), non_neg_integer()) :: boolean()
  def wrapped?(last, boot_ms), do: boot_ms < last and boot_ms + @wrap - last <= @day_ms

  @doc "How far apart two times (µs) of a boot are; between two of one boot the clock may have wrapped."
  @spec apart(integer(), integer()) :: non_neg_integer()
  def apart(a, b) do
    apart = Integer.mod(a - b, @wrap * 1_000)
    min(apart, @wrap * 1_000 - apart)
  end

  @doc """
  A reading from a kind of message that came `at` (µs): `:ok`, it is the vehicle's time now; `:behind`, an overtaken frame or the
  first sign of a reboot; `:reboot`, the clock has started over; `:none`, the message has no clock that tells.
  """
  @spec read(t(), id :: non_neg_integer(), non_neg_integer(), integer()) :: {t(), verdict()}
  def read(%{clocks: clocks, seed: seed} = all, id, boot_ms, at) do
    clock =
      Map.get(clocks, id) ||
        %{newest: seed, newest_at: all.seed_at, behind: nil, from: {at, boot_ms}, pace: :unknown}

    {clock, verdict} = clock |> pace(boot_ms, at) |> step(boot_ms, at)

    if verdict == :reboot and believed?(all, clock) do
      {%__MODULE__{seed: nil, clocks: %{id => clock}, proven: clock.pace == :good}, :reboot}
    else
      all = %{all | clocks: Map.put(clocks, id, clock), proven: all.proven or clock.pace == :good}
      {all, if(believed?(all, clock), do: verdict, else: doubted(verdict))}
    end
  end

  # An overtaken frame is old, whatever its clock counts.
  defp doubted(:behind), do: :behind
  defp doubted(_verdict), do: :none

  defp believed?(%{proven: proven}, %{pace: pace}), do: pace == :good or not (proven or fast?(pace))

  defp fast?(pace), do: is_integer(pace) and pace >= @strikes

  defp pace(%{from: {since, _boot_ms}} = clock, _boot, at) when at >= since and at - since < @pace_us,
    do: clock

  defp pace(%{from: {since, from}} = clock, boot_ms, at) do
    gone_us = (boot_ms - from) * 1000

    pace =
      cond do
        # Started over or wrapped; or another vehicle's, if it was not sure yet.
        at < since or gone_us < 0 ->
          if is_integer(clock.pace) and not fast?(clock.pace), do: 0, else: clock.pace

        gone_us < (at - since) * @too_fast ->
          :good

        is_integer(clock.pace) ->
          clock.pace + 1

        true ->
          1
      end

    %{clock | from: {at, boot_ms}, pace: pace}
  end

  defp step(%{newest: nil} = clock, boot_ms, at), do: {%{clock | newest: boot_ms, newest_at: at}, :ok}

  defp step(clock, boot_ms, at) do
    cond do
      fast?(clock.pace) -> {%{clock | newest: boot_ms, newest_at: at, behind: nil}, :none}
      ahead?(boot_ms, clock, at) -> {%{clock | newest: boot_ms, newest_at: at, behind: nil}, :ok}
      clock.newest - boot_ms <= @tolerance_ms -> {%{clock | behind: nil}, :ok}
      true -> behind(clock, boot_ms, at)
    end
  end

  defp behind(%{behind: nil} = clock, boot_ms, at), do: {%{clock | behind: {1, at, boot_ms}}, :behind}

  defp behind(%{behind: {count, since, from}} = clock, boot_ms, at) do
    if count + 1 >= @readings and at - since >= @span_us and
         (boot_ms - from) * 1000 < (at - since) * @too_fast do
      {%{clock | newest: boot_ms, newest_at: at, behind: nil}, :reboot}
    else
      {%{clock | behind: {count + 1, since, from}}, :behind}
    end
  end

  # After the wrap a small number is ahead of a big one. A reboot that falls half the range behind needs an uptime of more than 24
  # days.
  defp ahead?(boot_ms, %{newest: newest}, _at) when boot_ms >= newest, do: true

  defp ahead?(boot_ms, %{newest: newest} = clock, at) do
    gone_ms = boot_ms - newest &&& @wrap - 1
    gone_ms < @half and (newest >= @wrap - 60_000 or kept_time?(gone_ms, clock.newest_at, at))
  end

  defp kept_time?(_gone_ms, nil, _at), do: false

  defp kept_time?(gone_ms, since, at) do
    silent_ms = div(at - since, 1_000)
    abs(gone_ms - silent_ms) <= @tolerance_ms + div(silent_ms, @drift)
  end
end
