defmodule Aerie.Control.Params.Component do
  @moduledoc """
  The component whose parameters are meant: those of the autopilot, or of another component of the vehicle, such as a camera, which has its own and
  speaks PARAM_EXT (P8). MAVLink has no capability for that: a component that does not answer has no such parameters.
  """

  alias Aerie.Vehicle.Command.Error
  alias Aerie.Control.Params.{Message, Set}
  alias Aerie.Control.TransferExecutor.Job

  # 128 bytes in base64, and what stands before it.
  @max_text 180
  @integers -0x8000_0000_0000_0000..0xFFFF_FFFF_FFFF_FFFF

  @typedoc "Nil for the autopilot."
  @type t :: 1..255 | nil

  @doc "The options of a function that is for the autopilot only; it raises for a component."
  @spec none!(keyword()) :: keyword()
  def none!(options) do
    if Keyword.get(options, :component),
      do: raise(ArgumentError, "only list, get and set have the option :component"),
      else: options
  end

  @doc "Whether a number can be that of a component."
  @spec check(term()) :: :ok | {:error, [Error.t(), ...]}
  def check(component) when component == nil or component in 1..255, do: :ok
  def check(other), do: {:error, [Error.new("component", "an integer from 1 to 255", other)]}

  @doc "Whether a value can be one of some component; only its type tells whether it is one of this parameter."
  @spec check_value(term()) :: :ok | {:error, [Error.t(), ...]}
  def check_value(value) when is_float(value) or value in @integers, do: :ok
  def check_value(value) when is_binary(value) and byte_size(value) <= @max_text, do: :ok

  def check_value(other),
    do: {:error, [Error.new("value", "a number of up to 64 bits, or text of up to 128 bytes", other)]}

  @doc "The system and component that are asked."
  @spec target(Job.context(), t()) :: Message.target()
  def target(context, nil), do: context.target
  def target(%{target: {system, _autopilot}}, component), do: {system, component}

  @doc "The options of machines: how it speaks, and the measured round trip."
  @spec options(Job.context(), t()) :: keyword()
  def options(context, component) do
    autopilot? = target(context, component) == context.target
    encoding = if autopilot?, do: context.protocol.traits().param_encoding, else: :extended
    [encoding: encoding, rtt_us: context.rtt_us]
  end

  @doc "The machine that sets a parameter."
  @spec set(String.t(), number() | String.t(), 1..11 | nil, Job.context(), until :: integer(), t()) ::
          {:ok, Set.t()} | {:error, {:invalid, String.t()}}
  def set(name, value, type, context, until, component) do
    options = [type: type] ++ options(context, component)

    if is_number(value) or options[:encoding] == :extended,
      do: {:ok, Set.new(name, value, target(context, component), until, options)},
      else: {:error, {:invalid, "expected a number: component #{component} is the autopilot"}}
  end
end
