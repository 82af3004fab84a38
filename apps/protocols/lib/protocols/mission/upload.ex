defmodule Protocols.Mission.Upload do
  @moduledoc """
  A plan that a station writes, on the vehicle's side (W1-W7): items are requested one after the other, until all are
  there. A value, nil while there is none: `handle(upload, event, rules, now) -> {upload, actions}`.

  | event | |
  |---|---|
  | `{:count, message, from}` | a station begins; its owner has checked that it may (`busy/4`) |
  | `{:item, message, from}` | MISSION_ITEM_INT |
  | `{:cancelled, from}` | a station gives up (W6) |
  | `:tick` | time has passed |

  | action | |
  |---|---|
  | `{:send, message}` | to the station that is its target |
  | `{:store, items}` | all messages, in their order |
  | `:stray` | the item belongs to no upload of that station |

  The owner sets it to nil when the plan is stored. Until then the last item is requested again, so that the station
  waits.
  """

  alias MavCodec.Messages.MissionRequestInt
  alias Protocols.Mission.Reply

  @enforce_keys [:from, :type, :count, :progress_at, :asked_at]
  defstruct [:from, :type, :count, :progress_at, :asked_at, next: 0, items: []]

  @typedoc "`items`: those that came, the last one first; `:storing` when all are there. Times in us."
  @type t :: %__MODULE__{
          from: Reply.station(),
          type: 0..2,
          count: pos_integer(),
          next: non_neg_integer(),
          items: [struct()] | :storing,
          progress_at: integer(),
          asked_at: integer()
        }

  @typedoc """
  What vehicles do differently.

    * `:request` - the message that requests an item; MISSION_REQUEST_INT unless given
    * `:again_us`, `:patience_us` - after so long an item is requested again, and the upload given up
    * `:out_of_turn` - what an item gets that was not requested: `:ask` requests the right one, `:ask_unless_repeated`
      does so unless it is the one before; `:refuse`
  """
  @type rules :: %{
          optional(:request) => module(),
          again_us: pos_integer(),
          patience_us: number(),
          out_of_turn: :ask | :ask_unless_repeated | :refuse
        }
  @type event ::
          {:count | :item, struct(), Reply.station()} | {:cancelled, Reply.station()} | :tick
  @type action :: {:send, struct()} | {:store, [struct(), ...]} | :stray

  @doc "What keeps a station from beginning: a plan that is being stored, or another station that is not silent."
  @spec busy(t() | nil, Reply.station(), rules(), integer()) :: nil | :storing | :other
  def busy(nil, _from, _rules, _now), do: nil
  def busy(%{items: :storing}, _from, _rules, _now), do: :storing
  def busy(%{from: from}, from, _rules, _now), do: nil
  def busy(upload, _other, rules, now), do: if(now - upload.progress_at <= rules.patience_us, do: :other)

  @doc "Whether this is the item that was requested."
  @spec expects?(t() | nil, struct(), Reply.station()) :: boolean()
  def expects?(%{from: from, type: type, next: seq, items: items}, %{mission_type: type, seq: seq}, from),
    do: is_list(items)

  def expects?(_upload, _item, _from), do: false

  @doc "Handles an event."
  @spec handle(t() | nil, event(), rules(), integer()) :: {t() | nil, [action()]}
  def handle(upload, event, rules, now)

  def handle(_former, {:count, %{count: count, mission_type: type}, from}, rules, now) do
    ask(%__MODULE__{from: from, type: type, count: count, progress_at: now, asked_at: now}, rules, now)
  end

  def handle(%{from: from, type: type} = upload, {:item, %{mission_type: type} = item, from}, rules, now) do
    cond do
      upload.items == :storing -> {upload, []}
      item.seq == upload.next -> take(upload, item, rules, now)
      rules.out_of_turn == :refuse -> {upload, [{:send, Reply.ack(type, :INVALID_SEQUENCE, from)}]}
      rules.out_of_turn == :ask_unless_repeated and item.seq == upload.next - 1 -> {upload, []}
      true -> ask(upload, rules, now)
    end
  end

  def handle(upload, {:item, _item, _from}, _rules, _now), do: {upload, [:stray]}

  def handle(%{from: from, items: items}, {:cancelled, from}, _rules, _now) when is_list(items), do: {nil, []}
  def handle(upload, {:cancelled, _from}, _rules, _now), do: {upload, []}

  def handle(nil, :tick, _rules, _now), do: {nil, []}

  def handle(upload, :tick, rules, now) do
    cond do
      upload.items != :storing and now - upload.progress_at > rules.patience_us ->
        {nil, [{:send, Reply.ack(upload.type, :OPERATION_CANCELLED, upload.from)}]}

      now - upload.asked_at > rules.again_us ->
        ask(upload, rules, now)

      true ->
        {upload, []}
    end
  end

  defp take(%{next: next, count: count} = upload, item, _rules, now) when next + 1 == count do
    items = Enum.reverse([item | upload.items])
    {%{upload | items: :storing, progress_at: now, asked_at: now}, [{:store, items}]}
  end

  defp take(upload, item, rules, now),
    do: ask(%{upload | items: [item | upload.items], next: upload.next + 1, progress_at: now}, rules, now)

  defp ask(upload, rules, now) do
    module = Map.get(rules, :request, MissionRequestInt)
    {%{upload | asked_at: now}, [{:send, Reply.request(module, upload.type, upload.next, upload.from)}]}
  end
end
