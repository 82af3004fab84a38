defmodule Aerie.Control.Params.File.CommandLine do
  @moduledoc """
  What the command lines of Betaflight and iNav print (`diff all`, `dump`), and their configurators keep as `.txt`: lines such as `set NAME = VALUE`.

  A value may be a word (`set failsafe_procedure = DROP`), by the tables of `MavCodec.Msp.Params`. Settings of a profile count if it is the one that the file
  selects at its end. What is not a number there, and lines of other commands (`feature`, `aux`, `serial` …), are left out, with remarks that say so.
  """

  alias MavCodec.Msp.Params

  @set ~r/\Aset\s+(\S+)\s*=\s*(.*?)\s*\z/
  @profile ~r/\A(profile|rateprofile|control_profile|battery_profile|mixer_profile)\s+(\d{1,2})\z/
  @header ~r/^# (Betaflight|INAV|iNav)\b/m
  # Of the session with the command line, not of the vehicle.
  @silent ~w(diff dump defaults batch save exit version board_name manufacturer_id mcu_id signature board_info)
  @named 5

  @type line :: {String.t(), pos_integer()}
  @type setting :: {name :: String.t(), value :: String.t(), pos_integer()}

  @doc "Whether lines are of a command line."
  @spec lines?([line()]) :: boolean()
  def lines?(lines), do: Enum.any?(lines, fn {line, _number} -> line =~ @set end)

  @doc "The firmware that a file names in its comments; nil if it names none."
  @spec firmware(binary()) :: :betaflight | :inav | nil
  def firmware(text) do
    case Regex.run(@header, text) do
      [_all, "Betaflight"] -> :betaflight
      [_all, _inav] -> :inav
      nil -> nil
    end
  end

  @doc "The settings that are numbers, as text, and remarks. Words are known by their firmware."
  @spec settings([line()], :betaflight | :inav | nil) :: {[setting()], remarks :: [String.t()]}
  def settings(lines, firmware) do
    start = %{profile: nil, selected: %{}, settings: [], others: []}
    read = Enum.reduce(lines, start, &line/2)

    {active, other_profiles} =
      Enum.split_with(Enum.reverse(read.settings), fn {_setting, profile} ->
        profile == nil or read.selected[elem(profile, 0)] == elem(profile, 1)
      end)

    {numbers, texts} = active |> Enum.map(&number(elem(&1, 0), firmware)) |> Enum.split_with(&is_tuple/1)

    remarks =
      left("they are not numbers", texts) ++
        left(
          "they are of another profile",
          for({{name, _value, _line}, _profile} <- other_profiles, do: name)
        ) ++
        left("they are not settings", read.others |> Enum.reverse() |> Enum.uniq())

    {numbers, remarks}
  end

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

  defp number({name, value, line}, firmware) do
    cond do
      # Some words are numbers: 115200 for the second one.
      index = firmware && Params.word(firmware, name, value) -> {name, Integer.to_string(index), line}
      value =~ ~r/\A[+-]?\d+(\.\d+)?\z/ -> {name, value, line}
      true -> name
    end
  end

  defp left(_why, []), do: []

  defp left(why, names) do
    more = if length(names) > @named, do: " …", else: ""
    ["left out, because #{why}: #{names |> Enum.take(@named) |> Enum.join(", ")}#{more}"]
  end

  @doc "A parameter as a line, with the word of its value if that is known."
  @spec text(MavCodec.Msp.Messages.firmware(), String.t(), String.t()) :: String.t()
  def text(firmware, name, value), do: "set #{name} = #{words(firmware, name, value) || value}\n"

  defp words(firmware, name, value) do
    case Integer.parse(value) do
      {index, ""} when index >= 0 -> Enum.at(Params.words(firmware, name), index)
      _other -> nil
    end
  end
end
