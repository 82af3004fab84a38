defmodule Aerie.Vehicle.Command.Refusal do
  @moduledoc """
  Why a command or a change was refused: every reason, with the sentence that a user reads. A reason belongs to a rule,
  which has the status of the result, the HTTP status and what to do; the counters, the audit log and the table in
  `docs/commands.md` know the rule. The texts are in `refusal/`, a file for each part that refuses.

      Refusal.deny(:battery_low, command: "takeoff", floor: "30 %", left: "29.9 %")
      #=> {:deny, :battery, "takeoff needs 30 % of the battery's charge; 29.9 % is left"}

  The caller gives a reason, and a value for each `%{hole}` of its text. A test reads all these calls.
  """

  alias Aerie.Vehicle.Command.Refusal.{Commands, Policy, Unknown, Vehicle}
  alias Aerie.Vehicle.Command.Result

  @table for {rule, by, status, http, means, fix, texts} <- Policy.rules() ++ Commands.rules(),
             do: %{rule: rule, by: by, status: status, http: http, means: means, fix: fix, texts: texts}
  @rules for row <- @table, {reason, _text} <- row.texts, into: %{}, do: {reason, row.rule}
  @statuses Map.new(@table, &{&1.rule, &1.status})
  @http Map.new(@table, &{Atom.to_string(&1.rule), &1.http})
  # Words and holes in turn; the holes of these texts become atoms when this is compiled.
  pieces = fn text ->
    text
    |> String.split(["%{", "}"])
    |> Enum.with_index(&if rem(&2, 2) == 1, do: String.to_atom(&1), else: &1)
  end

  @ends for {status, texts} <- Vehicle.ends(), {reason, _text} <- texts, into: %{}, do: {reason, status}
  @texts Enum.flat_map(@table, & &1.texts)
         |> Enum.concat(Enum.flat_map(Vehicle.ends(), &elem(&1, 1)))
         |> Enum.concat(Unknown.texts())
         |> Map.new(fn {reason, text} -> {reason, pieces.(text)} end)

  @typedoc "What is counted, and what a program may compare."
  @type rule :: atom()

  @typedoc "A refusal."
  @type denial :: {:deny, rule(), String.t()}

  @doc """
  All rules: who says it, the status of the result, the HTTP status (nil: that of the result), what it means, what to
  do, and the texts by their reasons.
  """
  @spec table() :: [map()]
  def table, do: @table

  @doc "The words of each text, and its holes as atoms."
  @spec texts() :: %{(reason :: atom()) => [String.t() | atom()]}
  def texts, do: @texts

  @doc "A refusal for a reason."
  @spec deny(reason :: atom(), keyword()) :: denial()
  def deny(reason, values \\ []), do: {:deny, Map.fetch!(@rules, reason), text(reason, values)}

  @doc "The text of a reason."
  @spec text(reason :: atom(), keyword()) :: String.t()
  def text(reason, values \\ []) do
    @texts
    |> Map.fetch!(reason)
    |> Enum.map_join(&if is_atom(&1), do: Keyword.fetch!(values, &1), else: &1)
  end

  @doc "The end of a command or a transfer, for a reason that is not a refusal by a rule."
  @spec ended(reason :: atom(), keyword()) :: {Result.status(), String.t()}
  def ended(reason, values \\ []), do: {Map.fetch!(@ends, reason), text(reason, values)}

  @doc "The result of what was refused, or has ended."
  @spec result(id :: String.t(), denial() | {Result.status(), String.t() | nil}) :: Result.t()
  def result(id, {:deny, rule, text}),
    do: Result.new(id, Map.fetch!(@statuses, rule), text, %{"rule" => Atom.to_string(rule)})

  def result(id, {status, text}), do: Result.new(id, status, text)

  @doc "The HTTP status of a rule by its name; nil if the result decides it."
  @spec http(String.t() | nil) :: 400..599 | nil
  def http(name), do: @http[name]
end
