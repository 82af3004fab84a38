defmodule SimVehicle.PythonPeer do
  @moduledoc """
  Real ground-station code, pymavlink, as a peer of the tests: the scripts in `test/peers`.
  """

  @root Path.expand("../../../..", __DIR__)
  @peers Path.expand("../peers", __DIR__)

  @doc "The Python that has pymavlink, nil when there is none."
  @spec python() :: Path.t() | nil
  def python do
    venv = System.get_env("AERIE_VENV") || Path.join(@root, ".venv")
    python = Path.join(venv, "bin/python")
    if File.exists?(python), do: python
  end

  @doc "Runs a script to its end: what it printed, `%{name => value}`, and its exit code."
  @spec run(String.t(), [String.t()]) :: {%{String.t() => String.t()}, non_neg_integer, String.t()}
  def run(script, args) do
    {output, code} = System.cmd(python(), [Path.join(@peers, script) | args], stderr_to_stdout: true)

    findings =
      for line <- String.split(output, "\n", trim: true),
          [name, value] <- [String.split(line, " ", parts: 2)],
          into: %{} do
        {name, value}
      end

    {findings, code, output}
  end
end
