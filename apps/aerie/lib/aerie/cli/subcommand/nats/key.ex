defmodule Aerie.CLI.Subcommand.Nats.Key do
  @moduledoc """
  `aerie nats-key`: a key by which a program signs commands over NATS (`Aerie.Control.Policy.Roles.Signature`). The seed is in the file; what is
  printed is the section of a configuration that lists the public half.
  """
  @behaviour Aerie.CLI.Subcommand

  alias Aerie.Base.Files.Private
  alias Aerie.Base.Settings.Types
  alias Aerie.Control.Policy.Roles

  # A seed has 58 characters.
  @max_bytes 1_024

  @impl Aerie.CLI.Subcommand
  def run(%{arguments: %{"FILE" => file}, options: options, folder: folder}) do
    path = Path.expand(file, folder)

    with {:ok, name} <- name(options[:name] || Path.basename(path, Path.extname(path))),
         {:ok, role} <- role(options[:role] || "operator"),
         {:ok, public} <- public(path),
         do: {0, section(name, public, role)}
  end

  defp name(text) do
    case Types.parse_token(text) do
      {:ok, name} ->
        {:ok, name}

      :error ->
        {:error, "#{inspect(text)}: a name has at most 64 letters, digits, - and _; give one with --name"}
    end
  end

  defp role(text) do
    roles = Enum.map(Roles.all(), &Atom.to_string/1)

    if text in roles,
      do: {:ok, text},
      else: {:error, "--role #{text}: expected one of #{Enum.join(roles, ", ")}"}
  end

  # The key that there is stays: a new one would lock out the programs that have it.
  defp public(path) do
    with {:ok, %File.Stat{type: :regular, size: size}} when size <= @max_bytes <- File.stat(path),
         {:ok, text} <- File.read(path),
         {:ok, %Nkey{purpose: :user, public: public}} <- Nkey.from_seed(text) do
      {:ok, public}
    else
      {:error, :enoent} -> make(path)
      {:error, reason} when is_atom(reason) -> {:error, "cannot read #{path}: #{:file.format_error(reason)}"}
      _other -> {:error, "#{path} is there, and is not the seed of a user's nkey: name another file"}
    end
  end

  defp make(path) do
    key = Nkey.generate(:user)

    case Private.write(path, Nkey.seed(key) <> "\n") do
      :ok -> {:ok, key.public}
      {:error, reason} -> {:error, "cannot write #{path}: #{:file.format_error(reason)}"}
    end
  end

  defp section(name, public, role) do
    """
    policy:
      sources:
        - {name: #{name}, nkey: #{public}, role: #{role}}
    """
  end
end
