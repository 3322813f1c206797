// Saturated A-MPDU: best effort (EDCA, no TXOP limit), immediate Block Ack with a window of 64 frames, long
// guard interval, equal power at all stations and no noise errors. Every sender keeps its queue full for
// one sink. --loss makes the sink lose each data MPDU by itself with that probability (its preamble and the
// other MPDUs are received). --hidden: senders receive nothing of each other, only the sink. --amsdu:
// greatest A-MSDU.
// Prints standard, width_mhz, streams, mcs, senders, payload_bytes, ampdu_bytes, amsdu_bytes, loss, hidden,
// rts, run, seconds, received payload in Mbit/s, PPDUs with data per second, MPDUs per such PPDU, their
// mean air time in us, Block Acks and Block Ack requests per second, RTS per second, MPDUs dropped per
// second.
#include "network.h"

#include <memory>

using namespace reference;

// Loses data MPDUs with a probability; control frames are not lost.
class DataLoss : public ErrorModel
{
  public:
    explicit DataLoss(double fraction)
        : m_fraction(fraction),
          m_draw(CreateObject<UniformRandomVariable>())
    {
    }

  private:
    bool DoCorrupt(Ptr<Packet> packet) override
    {
        WifiMacHeader header;
        packet->PeekHeader(header);
        return header.IsData() && m_draw->GetValue() < m_fraction;
    }

    void DoReset() override
    {
    }

    double m_fraction;
    Ptr<UniformRandomVariable> m_draw;
};

// Counts what stations send.
struct Transmissions
{
    uint64_t data = 0; // PPDUs
    uint64_t mpdus = 0;
    Time air;
    uint64_t blockAcks = 0;
    uint64_t blockAckRequests = 0;
    uint64_t rts = 0;
};

int
main(int argc, char* argv[])
{
    std::string standard = "vht";
    uint16_t widthMhz = 80;
    uint32_t streams = 1;
    uint32_t mcs = 0;
    uint32_t senders = 1;
    uint32_t payloadBytes = 1400;
    uint32_t ampduBytes = 65535;
    uint32_t amsduBytes = 0;
    double loss = 0.0;
    bool hidden = false;
    bool rts = false;
    double seconds = 5.0;
    bool timeline = false;
    CommandLine command(__FILE__);
    command.AddValue("standard", "ht or vht", standard);
    command.AddValue("width", "channel width, MHz", widthMhz);
    command.AddValue("streams", "spatial streams", streams);
    command.AddValue("mcs", "MCS of one stream, 0 to 7 (HT) or 9 (VHT)", mcs);
    command.AddValue("senders", "saturated stations", senders);
    command.AddValue("payload", "UDP payload, B", payloadBytes);
    command.AddValue("ampdu", "greatest A-MPDU, B", ampduBytes);
    command.AddValue("amsdu", "greatest A-MSDU, B; 0: none", amsduBytes);
    command.AddValue("loss", "probability of the loss of an MPDU", loss);
    command.AddValue("hidden", "senders do not receive each other", hidden);
    command.AddValue("rts", "send RTS before each PPDU with data", rts);
    command.AddValue("seconds", "measured time", seconds);
    command.AddValue("timeline", "print transmissions", timeline);
    command.Parse(argc, argv);

    WifiSettings settings;
    settings.standard = standard == "ht" ? WIFI_STANDARD_80211n : WIFI_STANDARD_80211ac;
    settings.qos = true;
    settings.widthMhz = widthMhz;
    settings.dataMode = standard == "ht" ? "HtMcs" + std::to_string(mcs + 8 * (streams - 1))
                                         : "VhtMcs" + std::to_string(mcs);
    settings.streams = streams;
    settings.ampduBytes = ampduBytes;
    settings.amsduBytes = amsduBytes;
    settings.rtsThresholdBytes = rts ? 0 : settings.rtsThresholdBytes;
    NodeContainer nodes(senders + 1);
    const double powerDbm = -40.0;
    Ptr<PropagationLossModel> pathLoss = EqualPower(powerDbm);
    if (hidden)
    {
        auto matrix = CreateObject<MatrixPropagationLossModel>();
        matrix->SetDefaultLoss(300.0);
        pathLoss = matrix;
    }
    auto devices = InstallWifi(settings, nodes, pathLoss, Circle(senders + 1, 0.4));
    if (hidden)
    {
        for (uint32_t i = 0; i < senders; i++)
        {
            DynamicCast<MatrixPropagationLossModel>(pathLoss)->SetLoss(
                nodes.Get(i)->GetObject<MobilityModel>(),
                nodes.Get(senders)->GetObject<MobilityModel>(),
                settings.txPowerDbm - powerDbm);
        }
    }
    if (loss > 0)
    {
        DynamicCast<WifiNetDevice>(devices.Get(senders))
            ->GetPhy()
            ->SetPostReceptionErrorModel(CreateObject<DataLoss>(loss));
    }
    if (timeline)
    {
        PrintTransmissions(devices);
    }

    Transmissions sent;
    for (uint32_t i = 0; i <= senders; i++)
    {
        auto phy = DynamicCast<WifiNetDevice>(devices.Get(i))->GetPhy();
        phy->TraceConnectWithoutContext(
            "PhyTxPsduBegin",
            Callback<void, WifiConstPsduMap, WifiTxVector, double>(
                [&sent, phy](WifiConstPsduMap psdus, WifiTxVector vector, double) {
                    const auto psdu = psdus.begin()->second;
                    const auto& header = psdu->GetHeader(0);
                    if (header.IsData())
                    {
                        sent.data++;
                        sent.mpdus += psdu->GetNMpdus();
                        sent.air += WifiPhy::CalculateTxDuration(psdu, vector, phy->GetPhyBand());
                    }
                    sent.blockAcks += header.IsBlockAck();
                    sent.blockAckRequests += header.IsBlockAckReq();
                    sent.rts += header.IsRts();
                }));
    }
    Sink sink(devices.Get(senders));
    std::vector<std::unique_ptr<SaturatedSender>> traffic;
    for (uint32_t i = 0; i < senders; i++)
    {
        // more than a Block Ack window of full A-MSDUs
        traffic.push_back(std::make_unique<SaturatedSender>(devices.Get(i),
                                                            devices.Get(senders)->GetAddress(),
                                                            payloadBytes,
                                                            amsduBytes ? 700 : 200));
    }
    Simulator::Schedule(Seconds(1), [&] {
        sink.Reset();
        sent = Transmissions();
        for (auto& sender : traffic)
        {
            sender->Reset();
        }
    });
    Simulator::Stop(Seconds(1 + seconds));
    Simulator::Run();

    uint64_t dropped = 0;
    for (auto& sender : traffic)
    {
        dropped += sender->dropped;
    }
    std::cout << standard << "," << widthMhz << "," << streams << "," << mcs << "," << senders << ","
              << payloadBytes << "," << ampduBytes << "," << amsduBytes << "," << loss << "," << hidden << ","
              << rts << "," << RngSeedManager::GetRun() << "," << seconds << ","
              << sink.PayloadMbps(payloadBytes, seconds) << "," << sent.data / seconds << ","
              << double(sent.mpdus) / sent.data << "," << sent.air.GetSeconds() * 1e6 / sent.data << ","
              << sent.blockAcks / seconds << "," << sent.blockAckRequests / seconds << ","
              << sent.rts / seconds << "," << dropped / seconds << std::endl;
    Simulator::Destroy();
}
