defmodule Aerie.Params.SetExt do
  @moduledoc """
  Sets one parameter of a component that speaks PARAM_EXT (P8); this succeeds only when the component has reported the new value. Events,
  times and actions are those of `Aerie.Params.Download`; the result at the end is the parameter or a reason.

  If its type is not given, the parameter is read first. Then it is sent until PARAM_EXT_ACK answers. IN_PROGRESS is waited on for as
  long as the component answers; meanwhile the value is read, because the acknowledgement of the end comes once and can be lost.
  Acknowledgements do not say whose set they answer, so after each of them the value is read: what the component has decides,
  and the acknowledgement gives the reason.
  """

  alias Aerie.Ftp.RoundTrip
  alias Aerie.Params.{Message, Param}
  alias Aerie.Protocol.ExtValue
  alias MavCodec.Enums.ParamAck
  alias MavCodec.Messages, as: M

  @sends 8
  @denials 3
  @silence RoundTrip.silence()
  @progress_us 2_000_000
  @verdicts %{
    ParamAck.value(:PARAM_ACK_ACCEPTED) => :accepted,
    ParamAck.value(:PARAM_ACK_VALUE_UNSUPPORTED) => :unsupported,
    ParamAck.value(:PARAM_ACK_FAILED) => :failed,
    ParamAck.value(:PARAM_ACK_IN_PROGRESS) => :progress
  }

  @enforce_keys [:name, :value, :target, :deadline, :trip]
  defstruct [
    :name,
    :value,
    :type,
    :target,
    :deadline,
    :trip,
    :wire,
    :due,
    :since,
    :verdict,
    :shown,
    sent: 0,
    denials: 0,
    phase: :idle
  ]

  @type t :: %__MODULE__{}

  @typedoc """
    * `{:invalid, reason}` - the value does not fit; nothing was sent
    * `{:not_set, verdict, {:keeps, value} | :not_shown}` - `:unsupported` and `:failed` are the component's words; `:accepted` is said of a set
      whose new value the component does not show
    * `{:silent, component}` - there is no answer; `{:refused, text}` - the component says why there is no such parameter
    * `:deadline`, `:cancelled`
  """
  @type reason ::
          {:invalid, String.t()}
          | {:not_set, :accepted | :unsupported | :failed, {:keeps, ExtValue.t()} | :not_shown}
          | {:silent, 0..255}
          | {:refused, String.t()}
          | :deadline
          | :cancelled
  @type action :: {:send, [struct(), ...]} | {:done, {:ok, Param.t()} | {:error, reason()}}

  @doc "A set that has not begun. Options: `:type` (MAV_PARAM_EXT_TYPE, if known), `:rtt_us`."
  @spec new(String.t(), ExtValue.t(), Message.target(), deadline :: integer(), keyword()) :: t()
  def new(name, value, target, deadline, options \\ []) do
    %__MODULE__{
      name: name,
      value: value,
      type: options[:type],
      target: target,
      deadline: deadline,
      trip: RoundTrip.new(options[:rtt_us])
    }
  end

  @doc "When `{:tick, now}` has to come, nil for never."
  @spec wake_at(t()) :: integer() | nil
  def wake_at(%{phase: phase}) when phase in [:idle, :done], do: nil
  def wake_at(set), do: min(set.due, set.deadline)

  @spec handle(t(), Aerie.Params.Download.event()) :: {t(), [action()]}
  def handle(%{phase: :done} = set, _event), do: {set, []}
  def handle(set, {:cancel, _now}), do: finish(set, {:error, :cancelled})

  def handle(%{deadline: deadline} = set, {_event, now}) when now >= deadline,
    do: finish(set, {:error, :deadline})

  def handle(%{phase: :idle, type: nil} = set, {:start, now}), do: enter(set, :type, now)
  def handle(%{phase: :idle} = set, {:start, now}), do: begin(set, now)
  def handle(%{phase: :idle} = set, _early), do: {set, []}
  def handle(%{due: due} = set, {:tick, now}) when now >= due, do: late(set, now)

  def handle(%{target: from, name: name} = set, {:message, %M.ParamExtAck{param_id: name} = ack, from, now}),
    do: acknowledged(set, Map.get(@verdicts, ack.param_result, :failed), now)

  def handle(%{target: from} = set, {:message, message, from, now}) do
    case Message.about(message, set.name, :extended) do
      {:value, param} -> shown(set, param, now)
      {:refused, reason} -> finish(set, {:error, {:refused, reason}})
      :other -> {set, []}
    end
  end

  def handle(set, _other), do: {set, []}

  # The component works on it: a repeated set would be another one.
  defp acknowledged(%{phase: phase} = set, :progress, now) when phase in [:set, :progress],
    do: {%{set | phase: :progress, sent: 0, due: now + @progress_us}, []}

  defp acknowledged(%{phase: phase} = set, verdict, now) when phase in [:set, :progress],
    do: enter(%{set | verdict: verdict}, :check, now)

  # Of a set that was repeated, or of somebody else's.
  defp acknowledged(set, _verdict, _now), do: {set, []}

  defp shown(%{phase: :type} = set, param, now), do: begin(%{set | type: param.type}, now)
  # It may have been on its way when the value was sent.
  defp shown(%{phase: :set} = set, _param, _now), do: {set, []}

  defp shown(set, param, now) do
    cond do
      param.value == ExtValue.decode(set.wire, set.type) -> finish(set, {:ok, param})
      set.phase == :progress -> {%{set | sent: 0, due: now + @progress_us}, []}
      set.verdict == :accepted -> {%{set | shown: {:keeps, param.value}}, []}
      true -> not_set(set, {:keeps, param.value})
    end
  end

  # Another value can be an old one that comes late, so it has to be shown several times.
  defp late(%{phase: :check, shown: shown, denials: denials} = set, _now)
       when shown != nil and denials + 1 == @denials,
       do: not_set(set, shown)

  defp late(%{phase: :check, shown: shown} = set, now) when shown != nil,
    do: enter(%{set | shown: nil, denials: set.denials + 1}, :check, now)

  defp late(%{sent: sent, since: since} = set, now) when sent >= @sends and now - since >= @silence do
    if set.phase == :check,
      do: not_set(set, :not_shown),
      else: finish(set, {:error, Message.silence(set.target, :extended)})
  end

  defp late(set, now), do: again(set, now)

  defp begin(set, now) do
    case ExtValue.encode(set.value, set.type) do
      {:ok, wire} -> enter(%{set | wire: wire}, :set, now)
      {:error, reason} -> finish(set, {:error, {:invalid, reason}})
    end
  end

  defp enter(set, phase, now), do: again(%{set | phase: phase, sent: 0}, now)

  defp again(set, now) do
    message =
      if set.phase == :set,
        do: Message.set(set.target, set.name, set.wire, set.type, :extended),
        else: Message.read(set.target, set.name, :extended)

    since = if set.sent == 0, do: now, else: set.since
    due = now + RoundTrip.timeout(set.trip, set.sent)
    {%{set | sent: set.sent + 1, since: since, due: due}, [{:send, [message]}]}
  end

  defp not_set(set, shown), do: finish(set, {:error, {:not_set, set.verdict, shown}})
  defp finish(set, result), do: {%{set | phase: :done}, [{:done, result}]}
end
