defmodule Aerie.Control.Params.LongNames do
  @moduledoc """
  Names of parameters that are longer than MAVLink's 16 characters, as Betaflight and iNav have them. Programs and people see the whole
  name; on the way to the vehicle it is shortened (`MavCodec.Msp.ShortName`), and no other name is.
  """

  alias Aerie.Control.Params.{Metadata, Param, Table}
  alias MavCodec.Msp.{Message, Params, ShortName}
  alias MavCodec.Ftp.PackedParams

  @command_line ~r/\A[a-z0-9_]{1,64}\z/
  @msp [:betaflight, :inav]

  @doc "Whether this can be the name of a parameter: one of MAVLink, or a longer one of a command line, which has small letters, digits and `_`."
  @spec name?(term()) :: boolean()
  def name?(name), do: PackedParams.name?(name) or (is_binary(name) and name =~ @command_line)

  @doc "The name as MAVLink has it."
  @spec wire(String.t()) :: String.t()
  defdelegate wire(name), to: ShortName, as: :of

  @doc "A parameter, or all of a vehicle, with the whole names."
  @spec shown(Param.t() | Table.t(), Aerie.Vehicle.Firmware.name()) :: Param.t() | Table.t()
  def shown(%Param{} = param, firmware) when firmware in @msp,
    do: %{param | name: Params.full(firmware, param.name)}

  def shown(%Table{} = table, firmware) when firmware in @msp,
    do: Table.new(for name <- table.order, do: shown(table.params[name], firmware))

  def shown(params, _firmware), do: params

  @doc "The firmware of a snapshot, and the version of its parameters if that is known; nil without a snapshot."
  @spec release(map() | nil) :: {Aerie.Vehicle.Firmware.name(), Message.version() | nil} | nil
  def release(%{autopilot: firmware} = snapshot) when firmware in @msp,
    do: {firmware, Params.version(firmware, snapshot[:firmware])}

  def release(%{autopilot: firmware}), do: {firmware, nil}
  def release(_none), do: nil

  @doc """
  What is known of the parameters of a firmware that does not say it itself, nothing for an unknown version; nil for one
  that may.
  """
  @spec metadata(map()) :: {:ok, %{String.t() => Metadata.t()}} | nil
  def metadata(snapshot) do
    case release(snapshot) do
      {firmware, nil} when firmware in @msp -> {:ok, %{}}
      {firmware, version} when firmware in @msp -> {:ok, Params.described(firmware, version)}
      _other -> nil
    end
  end
end
