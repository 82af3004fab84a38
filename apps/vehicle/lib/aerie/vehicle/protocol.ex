defmodule Aerie.Vehicle.Protocol do
  @moduledoc """
  What a firmware's adapter does with a command (`Aerie.Vehicle.Firmware` lists the adapters). It turns the command into
  steps, steps into messages, and messages into answers. Adapters share `Aerie.Vehicle.Protocol.Mavlink`; the behaviour
  itself does not depend on MAVLink, so another protocol fits.

  An adapter declares what its firmware lacks, with the reason (`c:gap/2`). Such a command is refused at once, and
  nothing is sent to the vehicle.
  """

  alias Aerie.Vehicle.Command
  alias Aerie.Vehicle.Command.{Refusal, Type}
  alias Aerie.Vehicle.Protocol.{Step, Vehicle}

  @type plan :: [Step.t(), ...]
  @type message :: term()
  @type source :: {system :: non_neg_integer(), component :: non_neg_integer()}

  @typedoc """
  What a message says about a step:

    * `:ignore` - nothing
    * `:accepted` - the vehicle will try (C3); `{:accepted, reason}`: nothing more will come
    * `{:progress, share, text}` - under way; the share is 0..1, and both may be nil (C4)
    * `{:refused, :rejected | :failed, reason}` - the vehicle refuses, or could not do it
    * `{:failed, reason}` - the vehicle tried, and its texts say why it failed
    * `{:busy, reason}` - not now: a refusal, or, as the answer to a repetition, the vehicle is already doing it (C6)
    * `:cancelled` - the vehicle stopped on request (C5)
    * `:done` - the report that the condition `:told` waits for
    * `{:instead, step}` - the vehicle wants another form of the command
  """
  @type answer ::
          :ignore
          | :accepted
          | {:accepted, String.t()}
          | {:progress, float() | nil, String.t() | nil}
          | {:refused, :rejected | :failed, String.t()}
          | {:failed, String.t()}
          | {:busy, String.t()}
          | :cancelled
          | :done
          | {:instead, Step.t()}

  @doc "Why this firmware lacks a command on a kind of vehicle, whatever its parameters are; nil if it has it."
  @callback gap(type :: String.t(), kind :: String.t()) :: String.t() | nil

  @doc """
  The steps of a command without a gap; `{:gap, reason}` if the firmware lacks it with these parameters, `{:error, reason}`
  if too little is known about the vehicle, or its present state is against it.
  """
  @callback steps(Command.t(), Vehicle.t()) :: {:ok, plan()} | {:gap | :error, String.t()}

  @doc "The messages that send a step after `attempt` earlier attempts (C1)."
  @callback encode(Step.t(), attempt :: non_neg_integer(), Vehicle.t()) :: [message()]

  @doc "The messages that cancel a step; none, or the reason, if it cannot be cancelled."
  @callback cancel(Step.t(), Vehicle.t()) :: [message()] | {:error, String.t()}

  @doc "The messages that end a stream and release what it controlled."
  @callback release(Step.t(), Vehicle.t()) :: [message()]

  @doc "The verdict of a message from the vehicle on a step."
  @callback read(Step.t(), message(), source(), Vehicle.t()) :: answer()

  @doc "The ids of the messages that `c:read/4` needs for a step, besides texts, of which it gets all, each reassembled."
  @callback listens(Step.t()) :: [non_neg_integer()]

  @doc "Why a firmware has no plans of this kind; nil if it has them, or may have them."
  @callback plan_gap(mission_type :: 0..2) :: String.t() | nil

  @doc "Whether set-points must come before the vehicle does this (X7)."
  @callback setpoints_first?(Command.t(), Vehicle.t()) :: boolean()

  @doc "The steps of a command, or why there are none: `:gap` is permanent, `:error` temporary."
  @spec plan(module(), Command.t(), Vehicle.t()) :: {:ok, plan()} | {:gap, String.t()} | {:error, String.t()}
  def plan(protocol, command, vehicle) do
    case protocol.gap(command.type, vehicle.kind) do
      nil ->
        with {:ok, steps} <- protocol.steps(command, vehicle),
             :ok <- armed(protocol, Command.type(command), vehicle),
             do: {:ok, repeats(steps, Command.type(command).retry)}

      reason ->
        {:gap, reason}
    end
  end

  # It would be stored, and the vehicle set off as soon as it is armed.
  defp armed(protocol, type, %{armed: false} = vehicle) do
    if Type.taken_disarmed?(type, protocol.traits().setpoints_before_arming?, vehicle.kind),
      do: :ok,
      else: {:error, Refusal.text(:stored, command: type.name)}
  end

  defp armed(_protocol, _type, _armed), do: :ok

  # Steps before the last one, such as a mode, may be repeated.
  defp repeats(steps, retry), do: List.update_at(steps, -1, &%{&1 | repeat: retry})
end
