defmodule Aerie.Control.Params.Metadata do
  @moduledoc """
  What a vehicle says about its parameters: the files of MAVLink's component metadata, in JSON. Pure. Everything has a bound: what is longer is
  cut, what is more is left out.
  """

  # COMP_METADATA_TYPE
  @types %{parameters: 1, events: 4}
  @max_params 5_000
  @max_short 200
  @max_long 4_000
  @max_values 256

  @typedoc """
    * `:short`, `:long` - descriptions; `:unit`, `:group`, `:category` - texts; nil where the vehicle does not say it
    * `:min`, `:max`, `:default`, `:increment` - numbers; `:decimals` - places that are shown
    * `:values` - `%{value, text}` to choose from; `:bits` - `%{bit, text}` of a bit mask
  """
  @type t :: %{
          name: String.t(),
          type: String.t() | nil,
          short: String.t() | nil,
          long: String.t() | nil,
          unit: String.t() | nil,
          group: String.t() | nil,
          category: String.t() | nil,
          min: number() | nil,
          max: number() | nil,
          default: number() | nil,
          increment: number() | nil,
          decimals: number() | nil,
          reboot_required: boolean(),
          volatile: boolean(),
          values: [%{value: number(), text: String.t()}],
          bits: [%{bit: number(), text: String.t()}]
        }

  @doc """
  Where the general file says that the parameters, or the events, are described: a uri, and the checksum of that file if it names one.
  """
  @spec general(binary(), :parameters | :events) ::
          {:ok, {uri :: String.t(), crc :: non_neg_integer() | nil}} | {:error, String.t()}
  def general(text, what \\ :parameters) do
    number = Map.fetch!(@types, what)

    with {:ok, %{"metadataTypes" => types}} when is_list(types) <- JSON.decode(text),
         %{"uri" => uri} = type when is_binary(uri) <- Enum.find(types, &match?(%{"type" => ^number}, &1)) do
      {:ok, {uri, if(is_integer(type["fileCrc"]), do: type["fileCrc"])}}
    else
      nil -> {:error, "the vehicle describes no #{what}"}
      _other -> {:error, "the vehicle's general metadata is not as MAVLink has it"}
    end
  end

  @doc "The path of a file on board; only those are read."
  @spec path(uri :: String.t()) :: {:ok, Path.t()} | {:error, String.t()}
  def path("mftp://" <> path) when byte_size(path) in 1..239 and binary_part(path, 0, 1) != "[",
    do: {:ok, path}

  def path(uri),
    do:
      {:error,
       "the metadata is at #{String.slice(uri, 0, 120)}, and only files of the autopilot itself are read"}

  @doc "The descriptions by name."
  @spec decode(binary()) :: {:ok, %{String.t() => t()}} | {:error, String.t()}
  def decode(text) do
    case JSON.decode(text) do
      {:ok, %{"version" => 1, "parameters" => params}}
      when is_list(params) and length(params) <= @max_params ->
        {:ok,
         for(
           %{"name" => name} = param when byte_size(name) in 1..16 <- params,
           into: %{},
           do: {name, one(param)}
         )}

      {:ok, %{"parameters" => params}} when is_list(params) and length(params) > @max_params ->
        {:error, "the metadata describes #{length(params)} parameters, more than #{@max_params}"}

      _other ->
        {:error, "the parameters' metadata is not as MAVLink has it (version 1)"}
    end
  end

  defp one(param) do
    %{
      name: param["name"],
      type: text(param["type"], @max_short),
      short: text(param["shortDesc"], @max_short),
      long: text(param["longDesc"], @max_long),
      unit: text(param["units"], @max_short),
      group: text(param["group"], @max_short),
      category: text(param["category"], @max_short),
      min: number(param["min"]),
      max: number(param["max"]),
      default: number(param["default"]),
      increment: number(param["increment"]),
      decimals: number(param["decimalPlaces"]),
      reboot_required: param["rebootRequired"] == true,
      volatile: param["volatile"] == true,
      values: for({value, text} <- choices(param["values"], "value"), do: %{value: value, text: text}),
      bits: for({bit, text} <- choices(param["bitmask"], "index"), do: %{bit: bit, text: text})
    }
  end

  defp choices(all, key) when is_list(all) do
    for %{^key => value, "description" => text} when is_number(value) and is_binary(text) <-
          Enum.take(all, @max_values),
        do: {value, text(text, @max_short)}
  end

  defp choices(_none, _key), do: []

  defp text(text, max) when is_binary(text), do: String.slice(text, 0, max)
  defp text(_none, _max), do: nil

  defp number(n) when is_number(n), do: n
  defp number(_none), do: nil
end
