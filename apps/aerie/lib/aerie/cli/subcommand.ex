defmodule Aerie.CLI.Subcommand do
  @moduledoc """
  One row of the table of `bin/aerie` (`Aerie.CLI.Subcommands`). Parsing, `--help`, the man page and the completion of the shell are all
  made from it.

    * `:name` - one word or two (`config check`)
    * `:arguments` - `{name, meaning}` each; the last may end with `...` (one or more) or be in brackets (may be left out)
    * `:options` - `{name, kind, placeholder, meaning}`; the kind is `:boolean`, `:string`, `:integer`, `:float`, or
      `:keep` (text, may be repeated: a list)
    * `:where` - where it runs: `:here` (this VM), `:gateway` (the running one) or `:script` (the shell script starts a VM with a gateway:
      `Aerie.CLI.Start`)
    * `:module` - the module that implements `c:run/1`
    * `:more` - further lines of its help
    * `:terms` - words that its options may have, with what they mean: `{title, [{word, meaning}]}`
  """

  @enforce_keys [:name, :summary, :where]
  defstruct [:name, :summary, :where, :module, arguments: [], options: [], more: nil, terms: nil]

  @type option :: {atom(), :boolean | :string | :integer | :float | :keep, String.t() | nil, String.t()}
  @type t :: %__MODULE__{
          name: String.t(),
          summary: String.t(),
          where: :here | :gateway | :script,
          module: module() | nil,
          arguments: [{String.t(), String.t()}],
          options: [option()],
          more: String.t() | nil,
          terms: {String.t(), [{String.t(), String.t()}]} | nil
        }

  @typedoc """
  What `c:run/1` gets: the subcommand's name, its arguments by their names, its options, and the user's folder; in this VM also the rows of all
  subcommands.
  """
  @type request :: %{
          :name => String.t(),
          :arguments => %{String.t() => String.t() | [String.t()]},
          :options => %{atom() => term()},
          :folder => Path.t(),
          optional(:rows) => [t()]
        }

  @doc """
  Runs the subcommand: returns the exit status and what to print. An error ends with status 2 and goes to standard error. A subcommand that
  runs in a gateway still has the standard input and output of `aerie`.
  """
  @callback run(request()) :: {0..255, iodata()} | {:error, String.t()}

  @doc "The options that every subcommand of this kind has."
  @spec common(t() | %{where: :gateway}) :: [option()]
  def common(%{where: :gateway}) do
    [
      {:gateway, :string, "NAME", "the gateway to use if several run (default: the only one)"},
      {:dir, :string, "FOLDER",
       "the folder by which running gateways are found (default: AERIE_SHELL_DIR, else var/shell)"}
    ]
  end

  def common(_row), do: []

  @doc "How it is called: `status [OPTION ...]`."
  @spec usage(t()) :: String.t()
  def usage(%__MODULE__{} = row) do
    words = Enum.map(row.arguments, &elem(&1, 0))
    options = if row.options == [], do: [], else: ["[OPTION ...]"]
    Enum.join([row.name] ++ words ++ options, " ")
  end

  @doc "An option as the command line has it."
  @spec switch(atom()) :: String.t()
  def switch(name), do: "--" <> String.replace(Atom.to_string(name), "_", "-")
end
