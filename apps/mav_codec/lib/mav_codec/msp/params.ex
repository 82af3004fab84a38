defmodule MavCodec.Msp.Params do
  @moduledoc """
  The parameters of Betaflight and iNav by the names of their command lines, from `priv/msp`.

  Betaflight's are fields of configuration blocks (`block`, `field`; messages of `MavCodec.Msp.Messages`). From API 1.48 it reads and writes
  settings by name, and those without a block are parameters, too. iNav's are all read and written by name; they are those of 9.0.0, and a
  vehicle may have others. Ranges are those of Betaflight 2026.6.1 and iNav 9.0.0.

  MAVLink's names have 16 characters at most; `short` is what a longer one becomes there (`MavCodec.Msp.ShortName`).
  """

  alias MavCodec.Msp.{Message, Messages, ShortName}

  @folder Path.expand("../../../priv/msp", __DIR__)
  @betaflight Path.join(@folder, "betaflight_params.txt")
  @settings Path.join(@folder, "betaflight_settings.txt")
  @inav Path.join(@folder, "inav_params.txt")
  @external_resource @betaflight
  @external_resource @settings
  @external_resource @inav

  @typedoc """
  - `block`, `field`: of Betaflight: the message that reads it, and the field in it, nil for what it has by name only; `type`: of all others
  - `low`, `high`: the range, `values`: the words for its numbers from 0 on; nil or empty if not known
  - `base`, `step`: the number on the wire is `base + step * value`
  - `section`: of iNav: `"master"`, or of which profile it is a part
  """
  @type t :: %{
          name: String.t(),
          short: String.t(),
          block: String.t() | nil,
          field: atom | nil,
          type: String.t() | nil,
          section: String.t() | nil,
          unit: String.t() | nil,
          low: number | nil,
          high: number | nil,
          default: integer | nil,
          values: [String.t()],
          base: integer,
          step: pos_integer
        }

  @empty %{
    block: nil,
    field: nil,
    type: nil,
    section: nil,
    unit: nil,
    low: nil,
    high: nil,
    default: nil,
    values: [],
    base: 0,
    step: 1
  }

  read = fn path ->
    for line <- path |> File.read!() |> String.split("\n", trim: true), not String.starts_with?(line, "#") do
      case String.split(line, " values=", parts: 2) do
        [rest] -> {String.split(rest), []}
        [rest, values] -> {String.split(rest), String.split(values, ",")}
      end
    end
  end

  version = fn text -> text |> String.split(".") |> Enum.map(&String.to_integer/1) |> List.to_tuple() end

  attribute = fn
    "@" <> since, row ->
      %{row | since: version.(since)}

    "unit=" <> unit, row ->
      %{row | unit: unit}

    "default=" <> number, row ->
      %{row | default: String.to_integer(number)}

    "range=" <> range, row ->
      [low, high] = range |> String.split("..") |> Enum.map(&String.to_integer/1)
      %{row | low: low, high: high}

    "wire=" <> wire, row ->
      [base, step] = wire |> String.split("+") |> Enum.map(&String.to_integer/1)
      %{row | base: base, step: step}

    "was=" <> was, row ->
      [name, before] = String.split(was, "<")
      %{row | was: {name, version.(before)}}
  end

  @betaflight_rows (for {[name, block, field | attributes], values} <- read.(@betaflight) do
                      row =
                        Map.merge(@empty, %{
                          name: name,
                          block: block,
                          field: String.to_atom(field),
                          values: values
                        })

                      Enum.reduce(attributes, Map.merge(row, %{since: nil, was: nil}), attribute)
                    end)

  @named {1, 48}
  @betaflight_named (for {[name, type, low, high | attributes], values} <- read.(@settings) do
                       row =
                         Map.merge(@empty, %{
                           name: name,
                           type: type,
                           values: values,
                           low: String.to_integer(low),
                           high: String.to_integer(high)
                         })

                       Enum.reduce(attributes, Map.merge(row, %{since: @named, was: nil}), attribute)
                     end)
  @betaflight_all @betaflight_rows ++ @betaflight_named

  number = fn text -> if text =~ ".", do: String.to_float(text), else: String.to_integer(text) end

  @inav_rows (for {[name, type, section, low, high], values} <- read.(@inav) do
                Map.merge(@empty, %{
                  name: name,
                  type: type,
                  section: section,
                  low: number.(low),
                  high: number.(high),
                  values: values
                })
              end)

  @names %{
    betaflight:
      for(
        row <- @betaflight_all,
        name <- [row.name | List.wrap(row.was && elem(row.was, 0))],
        into: %{},
        do: {ShortName.of(name), name}
      ),
    inav: Map.new(@inav_rows, &{ShortName.of(&1.name), &1.name})
  }

  @words %{
    betaflight: for(row <- @betaflight_all, row.values != [], into: %{}, do: {row.name, row.values}),
    inav: for(row <- @inav_rows, row.values != [], into: %{}, do: {row.name, row.values})
  }

  @doc "The words for a parameter's numbers from 0 on, empty if it has none."
  @spec words(Messages.firmware(), name :: String.t()) :: [String.t()]
  def words(firmware, name), do: @words |> Map.fetch!(firmware) |> Map.get(name, [])

  @doc "The number of a word of a parameter; nil if it has none of that name."
  @spec word(Messages.firmware(), name :: String.t(), word :: String.t()) :: non_neg_integer | nil
  def word(firmware, name, word) do
    word = String.upcase(word)
    Enum.find_index(words(firmware, name), &(String.upcase(&1) == word))
  end

  @doc "Whether a firmware reads and writes settings by name."
  @spec by_name?(Messages.firmware(), Message.version()) :: boolean
  def by_name?(:inav, _version), do: true
  def by_name?(:betaflight, version), do: version >= @named

  @doc "The parameters of a version, in the order of the table."
  @spec all(Messages.firmware(), Message.version()) :: [t]
  def all(:betaflight, version) do
    for %{since: since, was: was} = row <- @betaflight_all, since == nil or version >= since do
      name =
        case was do
          {old, before} when version < before -> old
          _same -> row.name
        end

      row |> Map.drop([:since, :was]) |> Map.merge(%{name: name, short: ShortName.of(name)})
    end
  end

  def all(:inav, _version), do: for(row <- @inav_rows, do: Map.put(row, :short, ShortName.of(row.name)))

  @doc """
  The full name of a MAVLink name: the same, unless it is the short one of a known parameter. MAVProxy writes capitals.

      iex> MavCodec.Msp.Params.full(:betaflight, "p_roll")
      "p_roll"
      iex> MavCodec.Msp.Params.full(:betaflight, MavCodec.Msp.ShortName.of("vbat_min_cell_voltage"))
      "vbat_min_cell_voltage"
      iex> MavCodec.Msp.Params.full(:betaflight, "P_ROLL")
      "p_roll"
  """
  @spec full(Messages.firmware(), String.t()) :: String.t()
  def full(firmware, short) do
    names = Map.fetch!(@names, firmware)
    names[short] || names[String.downcase(short, :ascii)] || short
  end

  @doc "The full names by the short ones, of all versions."
  @spec names(Messages.firmware()) :: %{String.t() => String.t()}
  def names(firmware), do: Map.fetch!(@names, firmware)

  @doc "The parameters of all versions with the keys of MAVLink's component metadata, by their newest names."
  @spec described(Messages.firmware()) :: %{String.t() => map}
  def described(firmware) do
    nothing = %{short: nil, long: nil, category: nil, increment: nil, decimals: nil, bits: []}
    never = %{reboot_required: false, volatile: false}

    for row <- if(firmware == :betaflight, do: @betaflight_all, else: @inav_rows), into: %{} do
      values = for {text, value} <- Enum.with_index(row.values), do: %{value: value, text: text}

      known = %{
        min: row.low,
        max: row.high,
        default: row.default,
        values: values,
        group: row.block || row.section
      }

      {row.name,
       row |> Map.take([:name, :type, :unit]) |> Map.merge(known) |> Map.merge(nothing) |> Map.merge(never)}
    end
  end
end
