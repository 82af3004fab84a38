defmodule Aerie.Control.Params.File.CommandLine do
  @moduledoc """
  What the command lines of Betaflight and iNav print (`diff all`, `dump`), and their configurators keep as `.txt`:
  lines such as `set NAME = VALUE`.

  A value may be a word (`set failsafe_procedure = DROP`), by the tables of `MavCodec.Msp.Params` for the version.
  Settings of a profile count if it is the one that the file selects at its end. What is not a number there, words that
  the version does not have, and lines of other commands (`feature`, `aux`, `serial` …), are left out, with remarks that
  say so.
  """

  alias Aerie.Vehicle.Firmware
  alias MavCodec.Msp.{Message, Params}

  @set ~r/\Aset\s+(\S+)\s*=\s*(.*?)\s*\z/
  @profile ~r/\A(profile|rateprofile|control_profile|battery_profile|mixer_profile)\s+(\d{1,2})\z/
  @version "(?:[^\\n]*?\\s(?:20)?(\\d{1,2}\\.\\d{1,2})\\b)?"
  # These belong to the session with the command line, not to the vehicle.
  @silent ~w(diff dump defaults batch save exit version board_name manufacturer_id mcu_id signature board_info)
  @named 5

  @type line :: {String.t(), pos_integer()}
  @type setting :: {name :: String.t(), value :: String.t(), pos_integer()}

  @doc "Whether lines are of a command line."
  @spec lines?([line()]) :: boolean()
  def lines?(lines), do: Enum.any?(lines, fn {line, _number} -> line =~ @set end)

  @typedoc "A firmware, and its version if that is known."
  @type release :: {Firmware.name(), Message.version() | nil}

  @doc "Whether the firmware of a release has a command line that prints its parameters."
  @spec prints?(release() | nil) :: boolean()
  def prints?({firmware, _version}), do: Firmware.traits(firmware).command_line != []
  def prints?(nil), do: false

  @doc "The firmware that a file names in its comments, and its version; nil if it names none."
  @spec release(binary()) :: release() | nil
  def release(text) do
    names =
      for firmware <- Firmware.names(), name <- Firmware.traits(firmware).command_line, do: {name, firmware}

    alternatives = Enum.map_join(names, "|", &elem(&1, 0))

    case Regex.run(Regex.compile!("^# (#{alternatives})\\b#{@version}", "m"), text) do
      nil ->
        nil

      [_all, name | version] ->
        {_name, firmware} = List.keyfind(names, name, 0)
        {firmware, Params.version(Firmware.traits(firmware).param_tables, List.first(version))}
    end
  end

  @doc "The words of a release by the names of parameters; none if it is not known."
  @spec words(release() | nil) :: %{String.t() => [String.t()]}
  def words({firmware, version}) when version != nil,
    do: Params.words(Firmware.traits(firmware).param_tables, version)

  def words(_unknown), do: %{}

  @doc "The settings that are numbers, as text, and remarks."
  @spec settings([line()], release() | nil) :: {[setting()], remarks :: [String.t()]}
  def settings(lines, release) do
    start = %{profile: nil, selected: %{}, settings: [], others: []}
    read = Enum.reduce(lines, start, &line/2)
    words = words(release)

    {active, other_profiles} =
      Enum.split_with(Enum.reverse(read.settings), fn {_setting, profile} ->
        profile == nil or read.selected[elem(profile, 0)] == elem(profile, 1)
      end)

    {numbers, rest} =
      active |> Enum.map(&number(elem(&1, 0), words)) |> Enum.split_with(&(tuple_size(&1) == 3))

    remarks =
      left("they are not numbers", for({:text, name} <- rest, do: name)) ++
        left("this version does not have the word", for({:word, shown} <- rest, do: shown)) ++
        left(
          "they are of another profile",
          for({{name, _value, _line}, _profile} <- other_profiles, do: name)
        ) ++
        left("they are not settings", read.others |> Enum.reverse() |> Enum.uniq())

    {numbers, remarks ++ unknown(release)}
  end

  defp unknown({firmware, nil}),
    do: ["the words of this version of #{Firmware.title(firmware)} are not known: only numbers are read"]

  defp unknown(_known_or_none), do: []

  defp line({line, number}, read) do
    cond do
      found = Regex.run(@set, line) ->
        [_all, name, value] = found
        %{read | settings: [{{name, value, number}, read.profile} | read.settings]}

      found = Regex.run(@profile, line) ->
        [_all, kind, n] = found
        profile = {kind, String.to_integer(n)}
        %{read | profile: profile, selected: Map.put(read.selected, kind, elem(profile, 1))}

      true ->
        word = line |> String.split() |> List.first("")
        if word in @silent, do: read, else: %{read | others: [word | read.others]}
    end
  end

  defp number({name, value, line}, words) do
    index = Enum.find_index(words[name] || [], &(String.upcase(&1) == String.upcase(value)))

    cond do
      # Some words are numbers: 115200 for the second one.
      index -> {name, Integer.to_string(index), line}
      value =~ ~r/\A[+-]?\d+(\.\d+)?\z/ -> {name, value, line}
      words[name] -> {:word, "#{name} (#{String.slice(value, 0, 40)})"}
      true -> {:text, name}
    end
  end

  defp left(_why, []), do: []

  defp left(why, names) do
    more = if length(names) > @named, do: " …", else: ""
    ["left out, because #{why}: #{names |> Enum.take(@named) |> Enum.join(", ")}#{more}"]
  end

  @doc "A parameter as a line, with the word of its value where it has some: the command line takes no numbers there."
  @spec text(words :: %{String.t() => [String.t()]}, String.t(), String.t()) :: String.t()
  def text(words, name, value), do: "set #{name} = #{word(words[name], value) || value}\n"

  defp word(nil, _value), do: nil

  defp word(words, value) do
    case Integer.parse(value) do
      {index, ""} when index >= 0 -> Enum.at(words, index)
      _other -> nil
    end
  end

  @doc "The first lines of a file."
  @spec head(release()) :: String.t()
  def head({firmware, nil}),
    do:
      "# #{Firmware.title(firmware)}: save stores them and restarts the vehicle\n" <>
        "# The words of this version are not known: its command line refuses numbers in their place\n"

  def head({firmware, version}) do
    {_numbers, _version, release} =
      List.keyfind(Params.releases(Firmware.traits(firmware).param_tables), version, 1)

    "# #{Firmware.title(firmware)} #{release}: save stores them and restarts the vehicle\n"
  end
end
