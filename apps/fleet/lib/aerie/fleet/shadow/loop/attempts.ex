defmodule Aerie.Fleet.Shadow.Loop.Attempts do
  @moduledoc """
  The attempts to make a vehicle agree with its desired state, by field: how many, when the next one is due, and when to
  give up. A pure value.

  Each attempt that does not lead to agreement doubles the wait (`Aerie.Base.Timing.Backoff`), and after `max` attempts
  the field is refused until it is set again or the vehicle restarts. A field that stops agreeing uses an attempt as
  well, so the gateway gives up on a vehicle that keeps changing it back. Ten minutes of agreement reset the count.
  """

  alias Aerie.Base.Timing.Backoff
  alias Aerie.Fleet.Shadow.Document.Field

  defstruct max: 6, fields: %{}

  @type t :: %__MODULE__{max: pos_integer(), fields: %{Field.path() => attempt()}}
  @type attempt :: %{
          version: pos_integer(),
          tries: pos_integer(),
          next_at: integer(),
          reason: String.t() | nil,
          agreed_at: integer() | nil
        }

  @min_ms 2_000
  @max_ms 120_000
  @settled_us 600_000_000

  @doc "No attempts yet."
  @spec new(max :: pos_integer()) :: t()
  def new(max \\ 6), do: %__MODULE__{max: max}

  @doc "Whether a field may be tried at `now`: `:go`, `{:wait, until, reason}`, `{:end, reason}`."
  @spec may(t(), Field.path(), version :: pos_integer(), now :: integer()) ::
          :go | {:wait, integer(), String.t() | nil} | {:end, String.t()}
  def may(attempts, path, version, now) do
    case attempts.fields do
      %{^path => %{version: ^version} = attempt} ->
        cond do
          now < attempt.next_at -> {:wait, attempt.next_at, attempt.reason}
          attempt.tries >= attempts.max -> {:end, "#{attempt.tries} tries; #{reason(attempt)}"}
          true -> :go
        end

      _not_tried ->
        :go
    end
  end

  defp reason(%{reason: nil}), do: "the vehicle accepted it and its state does not show it for long"
  defp reason(%{reason: reason}), do: reason

  @doc "Records an attempt; `reason` says why it was refused, nil if it was not."
  @spec tried(t(), Field.path(), version :: pos_integer(), reason :: String.t() | nil, now :: integer()) ::
          t()
  def tried(attempts, path, version, reason, now) do
    tries =
      case attempts.fields do
        %{^path => %{version: ^version, tries: tries}} -> tries + 1
        _other_version -> 1
      end

    wait = Backoff.wait(tries, @min_ms, @max_ms, :erlang.phash2({path, version, tries}, 1000) / 1000)
    attempt = %{version: version, tries: tries, next_at: now + wait * 1000, reason: reason, agreed_at: nil}
    %{attempts | fields: Map.put(attempts.fields, path, attempt)}
  end

  @doc "Records the fields that agree at `now`; `known` are all desired fields, the others are forgotten."
  @spec agreed(t(), agreeing :: [Field.path()], known :: [Field.path()], now :: integer()) :: t()
  def agreed(attempts, agreeing, known, now) do
    fields =
      for {path, attempt} <- Map.take(attempts.fields, known),
          attempt = %{attempt | agreed_at: if(path in agreeing, do: attempt.agreed_at || now)},
          attempt.agreed_at == nil or now - attempt.agreed_at < @settled_us,
          into: %{},
          do: {path, attempt}

    %{attempts | fields: fields}
  end

  @doc "The clock was set by so many microseconds: every wait is as long as before."
  @spec moved(t(), integer()) :: t()
  def moved(attempts, step) do
    moved = fn attempt ->
      %{attempt | next_at: attempt.next_at + step, agreed_at: attempt.agreed_at && attempt.agreed_at + step}
    end

    %{attempts | fields: Map.new(attempts.fields, fn {path, attempt} -> {path, moved.(attempt)} end)}
  end

  @doc "Allows everything to be tried again, after a restart of the vehicle."
  @spec rebooted(t()) :: t()
  def rebooted(attempts), do: %{attempts | fields: %{}}
end
