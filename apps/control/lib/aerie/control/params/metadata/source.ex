defmodule Aerie.Control.Params.Metadata.Source do
  @moduledoc """
  Asks a vehicle where its metadata is (COMPONENT_METADATA, X14). Pure: events and actions are those of `Aerie.Control.Params.Fetch.Download`; the end is
  `{:done, {:ok, uri} | {:error, reason}}`.
  """

  alias Aerie.Control.Ftp.RoundTrip
  alias Aerie.Vehicle.Command.Refusal
  alias MavCodec.Enums.MavCmd
  alias MavCodec.Messages, as: M

  @request MavCmd.value(:MAV_CMD_REQUEST_MESSAGE)
  @sends 5
  @silence RoundTrip.silence()

  @enforce_keys [:target, :deadline, :trip]
  defstruct [:target, :deadline, :trip, :due, :since, sent: 0, phase: :idle]

  @type t :: %__MODULE__{}

  @doc "A request that has not been sent. Option: `:rtt_us`."
  @spec new({non_neg_integer(), 0..255}, deadline :: integer(), keyword()) :: t()
  def new(target, deadline, options \\ []),
    do: %__MODULE__{target: target, deadline: deadline, trip: RoundTrip.new(options[:rtt_us])}

  @doc "When `{:tick, now}` has to come, nil for never."
  @spec wake_at(t()) :: integer() | nil
  def wake_at(%{phase: :asked} = source), do: min(source.due, source.deadline)
  def wake_at(_source), do: nil

  @spec handle(t(), Aerie.Control.Params.Fetch.Download.event()) ::
          {t(), [Aerie.Control.Params.Fetch.Download.action()]}
  def handle(%{phase: :done} = source, _event), do: {source, []}
  def handle(source, {:cancel, _now}), do: finish(source, {:error, :cancelled})

  def handle(%{deadline: deadline} = source, {_event, now}) when now >= deadline,
    do: finish(source, {:error, :deadline})

  def handle(%{phase: :idle} = source, {:start, now}), do: ask(%{source | phase: :asked, since: now}, now)

  def handle(%{phase: :asked, target: from} = source, {:message, %M.ComponentMetadata{uri: uri}, from, _now}),
    do: finish(source, {:ok, uri})

  def handle(%{phase: :asked, sent: sent, due: due, since: since} = source, {:tick, now})
      when now >= due and sent >= @sends and now - since >= @silence,
      do: finish(source, {:error, Refusal.ended(:no_metadata)})

  def handle(%{phase: :asked, due: due} = source, {:tick, now}) when now >= due, do: ask(source, now)
  def handle(source, _other), do: {source, []}

  defp ask(%{target: {system, component}} = source, now) do
    message = %M.CommandLong{
      target_system: system,
      target_component: component,
      command: @request,
      confirmation: 0,
      param1: M.ComponentMetadata.id() * 1.0
    }

    {%{source | sent: source.sent + 1, due: now + RoundTrip.timeout(source.trip, source.sent)},
     [{:send, [message]}]}
  end

  defp finish(source, result), do: {%{source | phase: :done}, [{:done, result}]}
end
