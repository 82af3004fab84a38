defmodule MavCodec.Msp.Messages do
  @moduledoc """
  The messages of each firmware, from `priv/msp`. Gates are versions of the API with Betaflight (1.46), versions of the firmware with
  iNav (9.0), whose API has said 2.5 since 6.0. The same id may be another message in another firmware.
  """

  alias MavCodec.Msp.{Definition, Message}

  @files %{betaflight: "betaflight.txt", inav: "inav.txt"}
  @folder Path.expand("../../../priv/msp", __DIR__)

  for {_firmware, file} <- @files, do: @external_resource(Path.join(@folder, file))

  @tables Map.new(@files, fn {firmware, file} ->
            {firmware, Definition.parse!(File.read!(Path.join(@folder, file)))}
          end)
  @by_id Map.new(@tables, fn {firmware, messages} -> {firmware, Map.new(messages, &{&1.id, &1})} end)
  # Only ids: each of these tables is in memory by itself.
  @ids Map.new(@tables, fn {firmware, messages} -> {firmware, Map.new(messages, &{&1.name, &1.id})} end)

  # The compiler would take the whole of a table as its type, and compare it wherever a message is used: minutes for some modules.
  # `Function.identity/1` hides it.

  @type firmware :: :betaflight | :inav

  @doc "The firmwares that have a table."
  @spec firmwares() :: [firmware]
  def firmwares, do: Map.keys(@files)

  @doc "All messages of a firmware, by id."
  @spec all(firmware) :: [Message.t()]
  def all(firmware),
    do: @by_id |> Function.identity() |> Map.fetch!(firmware) |> Map.values() |> Enum.sort_by(& &1.id)

  @doc """
  A message by its id or its name.

      iex> {:ok, message} = MavCodec.Msp.Messages.fetch(:betaflight, 0x3010)
      iex> message.name
      "MSP2_CLI_SETTING"
      iex> MavCodec.Msp.Messages.fetch(:inav, "MSP2_CLI_SETTING")
      :error
  """
  @spec fetch(firmware, 0..0xFFFF | String.t()) :: {:ok, Message.t()} | :error
  def fetch(firmware, id) when is_integer(id),
    do: @by_id |> Function.identity() |> Map.fetch!(firmware) |> Map.fetch(id)

  def fetch(firmware, name) do
    ids = @ids |> Function.identity() |> Map.fetch!(firmware)
    with {:ok, id} <- Map.fetch(ids, name), do: fetch(firmware, id)
  end
end
