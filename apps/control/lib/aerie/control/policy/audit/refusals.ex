defmodule Aerie.Control.Policy.Audit.Refusals do
  @moduledoc """
  What the audit log has of those who may nothing: for each of them and each rule the first refusal of a minute,
  and then how many more there were. Without that a viewer could push everybody's records out of the log by
  commands that are refused.

  Counted in the caller's process, in `Aerie.Control.Policy.Memory.ClientHistory`, so that no flood reaches the process
  of the log; that one asks once a minute for counts that no further refusal has brought. What is written takes
  an eighth of the log at once, and another one in thirty days: all the rest is for the decisions of those who
  may something.
  """

  alias Aerie.Base.Names
  alias Aerie.Base.Timing.TokenBucket
  alias Aerie.Control.Policy.Roles
  alias Aerie.Control.Policy.Memory.ClientHistory

  @minute_us 60_000_000
  # Counts stay until the log's process has asked for them.
  @kept_us 3 * @minute_us
  @month_us 30 * 86_400_000_000
  # What a record takes.
  @bytes 512

  @type entry :: %{String.t() => term()}
  @type room :: TokenBucket.t() | nil

  @doc "Whether somebody may nothing at all: a viewer, or a stranger."
  @spec nobody?(Roles.source() | nil) :: boolean()
  def nobody?(%{may: []}), do: true
  def nobody?(source), do: source == nil or source.role == :viewer

  @doc "A refusal at `now` (monotonic µs): the entries that are to be written for it."
  @spec add(Names.gateway(), who :: String.t() | nil, rule :: atom(), entry(), now :: integer()) :: [entry()]
  def add(gateway, who, rule, entry, now) do
    begin = fn entries -> {:put, entries, %{since: now, more: 0, entry: entry}, now + @kept_us} end

    change = fn
      nil -> begin.([entry])
      %{since: since} = row when now - since >= @minute_us -> begin.(summed(row) ++ [entry])
      row -> {:put, [], %{row | more: row.more + 1}, row.since + @kept_us}
    end

    with :full <- ClientHistory.update(gateway, {who, :refused, rule}, now, change), do: []
  end

  @doc "The counts of minutes that are over, which are then forgotten."
  @spec due(Names.gateway(), now :: integer()) :: [entry()]
  def due(gateway, now) do
    old? = fn %{since: since} -> now - since >= @minute_us end
    gateway |> ClientHistory.take(:refused, old?) |> Enum.flat_map(&summed/1)
  end

  defp summed(%{more: 0}), do: []

  defp summed(%{more: more, entry: entry}) do
    words = ["source", "role", "client", "via", "rule", "message", "command", "vehicle"]

    [
      entry
      |> Map.take(words)
      |> Map.merge(%{"type" => "refusals", "decision" => "deny", "count" => more, "within_s" => 60})
    ]
  end

  @doc "Takes room for an entry in a log of so many bytes, at `now` (monotonic µs); `:none` while there is none."
  @spec room(room(), max_bytes :: pos_integer(), now :: integer()) :: {:ok, room()} | :none
  def room(room, max_bytes, now) do
    burst = max(div(max_bytes, 8 * @bytes), 16)
    TokenBucket.take(room, now, max(div(@month_us, burst), 1), burst)
  end
end
