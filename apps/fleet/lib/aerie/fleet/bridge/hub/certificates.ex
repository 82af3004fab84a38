defmodule Aerie.Fleet.Bridge.Hub.Certificates do
  @moduledoc """
  A fleet's certificate authority and its servers' certificates, made with `openssl` (ECDSA on P-256). Keys are for their owner only.
  """

  @days "3650"

  @doc "Makes `ca.pem` and `ca.key` in a folder, unless they are there."
  @spec authority(Path.t()) :: :ok | {:error, String.t()}
  def authority(dir) do
    key = Path.join(dir, "ca.key")

    if File.exists?(key) do
      :ok
    else
      with :ok <- key(key) do
        openssl(
          ~w(req -x509 -new -sha256 -days #{@days} -subj) ++
            ["/CN=Aerie fleet", "-key", key, "-out", Path.join(dir, "ca.pem")] ++
            [
              "-addext",
              "basicConstraints=critical,CA:TRUE",
              "-addext",
              "keyUsage=critical,keyCertSign,cRLSign"
            ]
        )
      end
    end
  end

  @doc "Makes `server.pem` and `server.key` in `dir` for these host names or addresses, signed by the authority in `ca`."
  @spec server(Path.t(), Path.t(), [String.t()]) :: :ok | {:error, String.t()}
  def server(ca, dir, hosts) do
    key = Path.join(dir, "server.key")
    request = Path.join(dir, "server.csr")
    extensions = Path.join(dir, "server.ext")
    names = "subjectAltName=" <> Enum.map_join(hosts, ",", &name/1)

    with :ok <- key(key),
         :ok <- openssl(~w(req -new -key #{key} -subj) ++ ["/CN=#{hd(hosts)}", "-out", request]),
         :ok <-
           wrote(File.write(extensions, names <> "\nextendedKeyUsage=serverAuth,clientAuth\n"), extensions),
         :ok <-
           openssl(
             ~w(x509 -req -sha256 -days #{@days} -set_serial) ++
               ["0x" <> Base.encode16(:crypto.strong_rand_bytes(16)), "-in", request] ++
               ["-CA", Path.join(ca, "ca.pem"), "-CAkey", Path.join(ca, "ca.key")] ++
               ["-extfile", extensions, "-out", Path.join(dir, "server.pem")]
           ) do
      Enum.each([request, extensions], &File.rm/1)
    end
  end

  defp name(host) do
    case :inet.parse_strict_address(String.to_charlist(host)) do
      {:ok, _ip} -> "IP:" <> host
      {:error, _} -> "DNS:" <> host
    end
  end

  # The file is private before there is anything in it.
  defp key(file) do
    with :ok <- wrote(Aerie.Base.Files.Private.write(file, ""), file),
         do: openssl(~w(ecparam -name prime256v1 -genkey -noout -out #{file}))
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
