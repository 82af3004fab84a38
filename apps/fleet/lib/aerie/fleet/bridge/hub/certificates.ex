defmodule Aerie.Fleet.Bridge.Hub.Certificates do
  @moduledoc """
  A fleet's certificate authority and its servers' certificates, made with `openssl` (ECDSA on P-256). Keys are for their owner only.
  """

  @days "3650"

  @doc "Makes `ca.pem` and `ca.key` in a folder, unless they are there."
  @spec authority(Path.t()) :: :ok | {:error, String.t()}
  def authority(dir) do
    key = Path.join(dir, "ca.key")
    pem = Path.join(dir, "ca.pem")

    # The key may be kept elsewhere. Another authority would make the files of all vehicles invalid.
    if File.exists?(pem),
      do: :ok,
      else: with(:ok <- if(File.exists?(key), do: :ok, else: key(key)), do: authority(key, pem))
  end

  defp authority(key, pem) do
    extensions = ["basicConstraints=critical,CA:TRUE", "keyUsage=critical,keyCertSign,cRLSign"]

    out(
      ~w(req -x509 -new -sha256 -days #{@days} -subj) ++
        ["/CN=Aerie fleet", "-key", key | Enum.flat_map(extensions, &["-addext", &1])],
      pem
    )
  end

  @doc "Makes `server.pem` and `server.key` in `dir` for these host names or addresses, signed by the authority in `ca`."
  @spec server(Path.t(), Path.t(), [String.t()]) :: :ok | {:error, String.t()}
  def server(ca, dir, hosts) do
    key = Path.join(dir, "server.key")
    request = Path.join(dir, "server.csr")
    extensions = Path.join(dir, "server.ext")
    names = "subjectAltName=" <> Enum.map_join(hosts, ",", &name/1)

    with :ok <- signs(Path.join(ca, "ca.key")),
         :ok <- key(key),
         :ok <- openssl(~w(req -new -subj) ++ [subject(hosts), "-key", key, "-out", request]),
         :ok <-
           wrote(File.write(extensions, names <> "\nextendedKeyUsage=serverAuth,clientAuth\n"), extensions),
         :ok <-
           out(
             ~w(x509 -req -sha256 -days #{@days} -set_serial) ++
               ["0x" <> Base.encode16(:crypto.strong_rand_bytes(16)), "-in", request] ++
               ["-CA", Path.join(ca, "ca.pem"), "-CAkey", Path.join(ca, "ca.key"), "-extfile", extensions],
             Path.join(dir, "server.pem")
           ) do
      Enum.each([request, extensions], &File.rm/1)
    end
  end

  defp signs(key) do
    if File.exists?(key),
      do: :ok,
      else:
        {:error, "#{key} is missing: put it there, because it signs the certificates of the hub's servers"}
  end

  # A common name has at most 64 characters; programs look at the alternative names.
  defp subject(hosts), do: "/CN=" <> String.slice(hd(hosts), 0, 64)

  defp name(host) do
    case :inet.parse_strict_address(String.to_charlist(host)) do
      {:ok, _ip} -> "IP:" <> host
      {:error, _} -> "DNS:" <> host
    end
  end

  # The file is private before there is anything in it.
  defp key(file) do
    with :ok <- wrote(Aerie.Base.Files.Private.write(file <> ".new", ""), file),
         do: out(~w(ecparam -name prime256v1 -genkey -noout), file)
  end

  # A file is there as a whole or not at all, whatever ends the program that makes it.
  defp out(arguments, file) do
    with :ok <- openssl(arguments ++ ["-out", file <> ".new"]),
         do: wrote(File.rename(file <> ".new", file), file)
  end

  defp wrote(:ok, _file), do: :ok
  defp wrote({:error, reason}, file), do: {:error, "cannot write #{file}: #{:file.format_error(reason)}"}

  defp openssl(arguments) do
    with program when program != nil <- System.find_executable("openssl"),
         {_said, 0} <- System.cmd(program, arguments, stderr_to_stdout: true) do
      :ok
    else
      nil -> {:error, "cannot find the program openssl: install it (apt-get install openssl)"}
      {said, status} -> {:error, "openssl ended with status #{status}: #{String.slice(said, -300, 300)}"}
    end
  end
end
