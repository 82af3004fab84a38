defmodule Msp.Session.Tasks.Armed do
  @fresh_us 1_000_000

  @moduledoc """
  Whether the vehicle is armed: `:armed`, `:disarmed`, or `:unknown`. A vehicle that has not said so for
  #{div(@fresh_us, 1_000_000)} s is unknown, as
  is one whose BOXIDS does not say which flag means armed.

  What is dangerous while it is armed needs `:disarmed` (`refusal/1`); what is dangerous while it is disarmed needs
  `:armed`. Before a write that is not for armed
  vehicles is sent, `Msp.Session.Tasks` asks a vehicle that is unknown once more.
  """

  alias MavCodec.Msp.{Frame, Message}
  alias Msp.{Meaning, Modes, Session}

  @type state :: :armed | :disarmed | :unknown

  @doc "Whether it is armed, at the time of the session's event."
  @spec state(Session.t()) :: state
  def state(%{readings: %{boxes: boxes, boxes_at: at}, now: now}) when now - at <= @fresh_us,
    do: if(Modes.armed?(boxes), do: :armed, else: :disarmed)

  def state(_session), do: :unknown

  @doc "Why something that is dangerous while the vehicle is armed cannot be done; nil if it is disarmed."
  @spec refusal(Session.t()) :: String.t() | nil
  def refusal(session), do: why(state(session))

  @doc "The same for a request that may wait until the vehicle was asked again: nil unless it says that it is armed."
  @spec early(Session.t()) :: String.t() | nil
  def early(session), do: if(state(session) == :armed, do: why(:armed))

  defp why(:disarmed), do: nil
  defp why(:armed), do: "it is armed"
  defp why(:unknown), do: "whether it is armed is not known: try again"

  @doc "Whether a request is only for disarmed vehicles."
  @spec only_disarmed?(Message.t(), Frame.t()) :: boolean
  def only_disarmed?(%{armed: :yes}, _frame), do: false
  def only_disarmed?(%{kind: :read}, _frame), do: true
  def only_disarmed?(message, frame), do: not Meaning.reads?(message, frame)
end
