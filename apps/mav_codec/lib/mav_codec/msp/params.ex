defmodule MavCodec.Msp.Params do
  @moduledoc """
  The parameters of Betaflight and iNav by the names of their command lines, from `priv/msp`.

  Betaflight's are fields of configuration blocks (`block`, `field`; messages of `MavCodec.Msp.Messages`). From API 1.48
  on it reads and writes settings by name, and those without a block are parameters as well. iNav's are all read and
  written by name; they are those of 9.0.0, and a vehicle may have others. Names, ranges and words are those of the
  newest version; what they were before is in files of their own.

  MAVLink's names have 16 characters at most; `short` is what a longer one becomes there (`MavCodec.Msp.ShortName`).
  """

  alias MavCodec.Msp.{Message, Messages, ShortName}

  @folder Path.expand("../../../priv/msp", __DIR__)
  @betaflight Path.join(@folder, "betaflight_params.txt")
  @settings Path.join(@folder, "betaflight_settings.txt")
  @inav Path.join(@folder, "inav_params.txt")
  @inav_words Path.join(@folder, "inav_words.txt")
  @before Map.new([:betaflight, :inav], &{&1, Path.join(@folder, "#{&1}_before.txt")})
  for file <- [@betaflight, @settings, @inav, @inav_words | Map.values(@before)], do: @external_resource(file)

  # By the versions of the messages: the API's of Betaflight, the firmware's of iNav.
  @releases %{
    betaflight: [
      {{3, 5}, {1, 40}, "3.5"},
      {{4, 0}, {1, 41}, "4.0"},
      {{4, 1}, {1, 42}, "4.1"},
      {{4, 2}, {1, 43}, "4.2"},
      {{4, 3}, {1, 44}, "4.3"},
      {{4, 4}, {1, 45}, "4.4"},
      {{4, 5}, {1, 46}, "4.5"},
      {{25, 12}, {1, 47}, "2025.12"},
      {{26, 6}, {1, 48}, "2026.6"},
      {{26, 12}, {1, 49}, "2026.12"}
    ],
    inav: for({major, minor} = n <- [{7, 0}, {7, 1}, {8, 0}, {9, 0}, {9, 1}], do: {n, n, "#{major}.#{minor}"})
  }

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
      Map.put(row, :since, version.(since))

    "until=" <> until, row ->
      Map.put(row, :until, version.(until))

    "name=" <> name, row ->
      Map.put(row, :name, name)

    "unit=" <> unit, row ->
      Map.put(row, :unit, unit)

    "default=" <> number, row ->
      Map.put(row, :default, String.to_integer(number))

    "range=" <> range, row ->
      [low, high] = range |> String.split("..") |> Enum.map(&String.to_integer/1)
      Map.merge(row, %{low: low, high: high, values: []})

    "wire=" <> wire, row ->
      [base, step] = wire |> String.split("+") |> Enum.map(&String.to_integer/1)
      Map.merge(row, %{base: base, step: step})
  end

  # What each setting was before a version, the newest first.
  @changes Map.new(@before, fn {firmware, file} ->
             rows =
               for {[name, "<" <> below | attributes], values} <- read.(file) do
                 words = if values == [], do: %{}, else: %{values: values, low: 0, high: length(values) - 1}
                 {name, {version.(below), Enum.reduce(attributes, words, attribute)}}
               end

             {firmware, Enum.group_by(rows, &elem(&1, 0), &elem(&1, 1))}
           end)

  @betaflight_rows (for {[name, block, field | attributes], values} <- read.(@betaflight) do
                      row =
                        Map.merge(@empty, %{
                          name: name,
                          block: block,
                          field: String.to_atom(field),
                          values: values
                        })

                      Enum.reduce(attributes, Map.merge(row, %{since: nil, until: nil}), attribute)
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

                       Enum.reduce(attributes, Map.merge(row, %{since: @named, until: nil}), attribute)
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

  @others %{
    betaflight: [],
    inav: for({[name], values} <- read.(@inav_words), do: Map.merge(@empty, %{name: name, values: values}))
  }

  @names Map.new([betaflight: @betaflight_all, inav: @inav_rows], fn {firmware, rows} ->
           before = for {_name, changes} <- @changes[firmware], {_below, %{name: name}} <- changes, do: name
           {firmware, Map.new(Enum.map(rows, & &1.name) ++ before, &{ShortName.of(&1), &1})}
         end)

  @doc "The known releases, the oldest first: each with the version by which its messages are read, and as text."
  @spec releases(Messages.firmware()) :: [{{byte, byte}, Message.version(), String.t()}]
  def releases(firmware), do: Map.fetch!(@releases, firmware)

  @doc """
  The version of a release as AUTOPILOT_VERSION has it; nil for one that is not known.

      iex> MavCodec.Msp.Params.version(:betaflight, "4.5.5")
      {1, 46}
      iex> MavCodec.Msp.Params.version(:betaflight, "26.6.1")
      {1, 48}
      iex> MavCodec.Msp.Params.version(:inav, "8.0.1")
      {8, 0}
      iex> MavCodec.Msp.Params.version(:betaflight, "4.6.0")
      nil
  """
  @spec version(Messages.firmware(), String.t() | nil) :: Message.version() | nil
  def version(firmware, text) do
    with [major, minor | _patch] <- String.split(text || "", "."),
         {major, ""} <- Integer.parse(major),
         {minor, ""} <- Integer.parse(minor),
         {_release, version, _text} <- List.keyfind(releases(firmware), {major, minor}, 0) do
      version
    else
      _unknown -> nil
    end
  end

  @doc "The words for the numbers from 0 on of all parameters that have some."
  @spec words(Messages.firmware(), Message.version()) :: %{String.t() => [String.t()]}
  def words(firmware, version),
    do:
      for(
        row <- rows(firmware, version) ++ Map.fetch!(@others, firmware),
        %{values: [_ | _]} = row <- [at(firmware, row, version)],
        into: %{},
        do: {row.name, row.values}
      )

  @doc "Whether a firmware reads and writes settings by name."
  @spec by_name?(Messages.firmware(), Message.version()) :: boolean
  def by_name?(:inav, _version), do: true
  def by_name?(:betaflight, version), do: version >= @named

  @doc "The parameters of a version, in the order of the table."
  @spec all(Messages.firmware(), Message.version()) :: [t]
  def all(firmware, version) do
    for row <- rows(firmware, version) do
      row =
        @changes
        |> Map.fetch!(firmware)
        |> Map.get(row.name, [])
        |> Enum.reduce(row, &before(&1, &2, version))

      # Defaults are those of 2026.6.
      row = if firmware == :betaflight and version < @named, do: %{row | default: nil}, else: row
      Map.put(row, :short, ShortName.of(row.name))
    end
  end

  defp at(firmware, row, version),
    do:
      @changes |> Map.fetch!(firmware) |> Map.get(row.name, []) |> Enum.reduce(row, &before(&1, &2, version))

  defp before({below, changes}, row, version) when version < below, do: Map.merge(row, changes)
  defp before(_later, row, _version), do: row

  defp rows(:inav, _version), do: @inav_rows

  defp rows(:betaflight, version) do
    for %{since: since, until: until} = row <- @betaflight_all,
        since == nil or version >= since,
        until == nil or version < until,
        do: Map.drop(row, [:since, :until])
  end

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

  @doc "The parameters of a version with the keys of MAVLink's component metadata."
  @spec described(Messages.firmware(), Message.version()) :: %{String.t() => map}
  def described(firmware, version) do
    nothing = %{short: nil, long: nil, category: nil, increment: nil, decimals: nil, bits: []}
    never = %{reboot_required: false, volatile: false}

    for row <- all(firmware, version), into: %{} do
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
