defmodule Aerie.Control.Params.LongNames do
  @moduledoc """
  Names of parameters that are longer than MAVLink's 16 characters, as Betaflight and iNav have them. Programs and people see the whole
  name; on the way to the vehicle it is shortened (`MavCodec.Msp.ShortName`), and no other name is.
  """

  alias Aerie.Control.Params.{Metadata, Param, Table}
  alias Aerie.Vehicle.Firmware
  alias MavCodec.Msp.{Message, Params, ShortName}
  alias MavCodec.Ftp.PackedParams

  @command_line ~r/\A[a-z0-9_]{1,64}\z/

  @doc "Whether this can be the name of a parameter: one of MAVLink, or a longer one of a command line, which has small letters, digits and `_`."
  @spec name?(term()) :: boolean()
  def name?(name), do: PackedParams.name?(name) or (is_binary(name) and name =~ @command_line)

  @doc "The name as MAVLink has it."
  @spec wire(String.t()) :: String.t()
  defdelegate wire(name), to: ShortName, as: :of

  @doc "A parameter, or all of a vehicle, with the whole names."
  @spec shown(Param.t() | Table.t(), Firmware.name()) :: Param.t() | Table.t()
  def shown(params, firmware) do
    case Firmware.traits(firmware).param_tables do
      nil -> params
      tables -> whole(params, tables)
    end
  end

  defp whole(%Param{} = param, tables), do: %{param | name: Params.full(tables, param.name)}

  defp whole(%Table{} = table, tables),
    do: Table.new(for name <- table.order, do: whole(table.params[name], tables))

  @doc "The firmware of a snapshot, and the version of its parameters if that is known; nil without a snapshot."
  @spec release(map() | nil) :: {Firmware.name(), Message.version() | nil} | nil
  def release(%{autopilot: firmware} = snapshot) do
    tables = Firmware.traits(firmware).param_tables
    {firmware, tables && Params.version(tables, snapshot.firmware)}
  end

  def release(_none), do: nil

  @doc """
  What is known of the parameters of a firmware that does not say it itself, nothing for an unknown version; nil for one
  that may.
  """
  @spec metadata(map()) :: {:ok, %{String.t() => Metadata.t()}} | nil
  def metadata(snapshot) do
    with {firmware, version} <- release(snapshot),
         tables when tables != nil <- Firmware.traits(firmware).param_tables,
         do: {:ok, if(version, do: Params.described(tables, version), else: %{})}
  end
end
